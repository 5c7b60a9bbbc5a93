"""Curriculum stages: parts of one training, each under the run's configuration with some values changed."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from hrl_comfort.config.checks import ConfigError
from hrl_comfort.config.commands import TrainConfig
from hrl_comfort.config.learning import StageConfig
from hrl_comfort.config.overrides import one_line
from hrl_comfort.config.structured import freeze, schema

SETTABLE = ("agent", "comfort", "curriculum", "human", "reward", "task.precision", "task.resample_start_probability")
FIXED = (
    "agent.policy_steps", "agent.learning_starts", "agent.batch_size", "agent.buffer_size", "agent.hidden",
    "agent.critic_layer_norm", "agent.entropy_coefficient", "agent.normalise", "agent.device", "agent.log_every",
    "agent.checkpoint_every",
    "agent.keep_checkpoints", "comfort.levels", "curriculum.stages",
)  # fmt: skip
"""Keys that hold for the whole training: sizes, budgets, and what is counted over all stages."""
EPISODE_SEEDS = 10_000
"""Stage k draws its episodes from `episode_seed` + k times this."""


def stages_of(config: TrainConfig) -> list[tuple[StageConfig, TrainConfig]]:
    """Return every stage of a training and the configuration that is in force in it.

    Each is the run's own configuration with that stage's values: they do not accumulate from stage to stage. A
    training without stages is one stage, `train`.

    Raises:
        ConfigError: a stage sets a key that is not there or that holds for the whole training, or its value is not
            allowed.
    """
    stages = list(config.curriculum.stages)
    if not stages:
        return [(StageConfig(name="train", policy_steps=config.agent.policy_steps), config)]
    found = []
    for number, stage in enumerate(stages):
        try:
            found.append((stage, _in_stage(config, stage, number)))
        except (ConfigError, OmegaConfBaseException) as error:
            raise ConfigError(f"curriculum.stages.{number} ({stage.name}): {one_line(error)}") from error
    return found


def _in_stage(config: TrainConfig, stage: StageConfig, number: int) -> TrainConfig:
    node = OmegaConf.merge(OmegaConf.structured(schema(TrainConfig)), dataclasses.asdict(config))
    node.curriculum.stages = []
    node.agent.policy_steps = stage.policy_steps
    node.episode_seed += number * EPISODE_SEEDS
    for key, value in flat(stage.set):
        if key in FIXED or not any(f"{key}.".startswith(f"{part}.") for part in SETTABLE):
            raise ConfigError(f"{key} cannot change within a training; a stage sets values of {', '.join(SETTABLE)}")
        OmegaConf.update(node, key, value)
    changed = freeze(TrainConfig, node)
    if (changed.comfort.source == "none") != (config.comfort.source == "none"):
        raise ConfigError(f"comfort.source={changed.comfort.source} changes whether the policy sees the level")
    return changed


def flat(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the leaves of nested values by their dotted keys."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{before}{key}.")
        else:
            yield before + key, value


def settle_budget(node: Any, total: int | None) -> None:
    """Set `agent.policy_steps` to the sum of the stages, or scale the stages to the `total` asked for."""
    stages = node.curriculum.stages
    if not stages or OmegaConf.missing_keys(stages):
        return
    asked = [stage.policy_steps for stage in stages]
    if total is not None and sum(asked) > 0:
        ends = [round(total * sum(asked[: i + 1]) / sum(asked)) for i in range(len(asked))]
        for stage, begin, end in zip(stages, [0, *ends], ends, strict=False):
            stage.policy_steps = end - begin
    node.agent.policy_steps = sum(stage.policy_steps for stage in stages)
