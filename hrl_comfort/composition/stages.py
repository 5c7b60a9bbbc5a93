"""Curriculum stages: parts of one training, each under the run's configuration with some values changed."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any, TypeVar

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from hrl_comfort.config.checks import ConfigError, section
from hrl_comfort.config.hydra_conf import freeze
from hrl_comfort.config.learning import StageConfig
from hrl_comfort.config.overrides import check_overrides, one_line, override
from hrl_comfort.config.training import TrainConfig

T = TypeVar("T", bound=TrainConfig)
SETTABLE = (
    "agent", "comfort", "curriculum", "human", "randomise", "reward", "task.precision",
    "task.resample_start_probability",
)  # fmt: skip
FIXED = (
    "agent.name", "agent.own", "agent.policy_steps", "agent.learning_starts", "agent.batch_size", "agent.buffer_size",
    "agent.hidden", "agent.critic_layer_norm", "agent.entropy_coefficient", "agent.normalise", "agent.device",
    "agent.log_every", "agent.checkpoint_every", "agent.keep_checkpoints", "comfort.levels", "curriculum.stages",
)  # fmt: skip
"""Keys that hold for the whole training: sizes, budgets, and what is counted over all stages."""
EPISODE_SEEDS = 10_000
"""Stage k draws its episodes from `episode_seed` + k times this."""


def train_config(config: TrainConfig, **changes: Any) -> TrainConfig:
    """Return the fields of `config` that a training of one policy has, with `changes`."""
    fields = {field.name: getattr(config, field.name) for field in dataclasses.fields(TrainConfig)}
    return TrainConfig(**{**fields, **changes})


def stages_of(config: TrainConfig, key: str = "curriculum.stages") -> list[tuple[StageConfig, TrainConfig]]:
    """Return every stage of a training and the configuration that is in force in it.

    Each is the run's own configuration with that stage's values: they do not accumulate from stage to stage. A
    training without stages is one stage, `train`. An error names the stages by `key`.

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
            raise ConfigError(f"{key}.{number}.set: {one_line(error)}") from error
    for number, (one, (stage, other)) in enumerate(pairwise(found), start=1):
        if stage.replay == "keep" and _rewarded_starts(one[1]) != _rewarded_starts(other):
            raise ConfigError(
                f"{key}.{number}.replay=keep does not go with another agent.next_skill than before, or with "
                "agent.next_skill_reward from or to 0: transitions are kept for one skill; choose clear"
            )
    return found


def _rewarded_starts(config: TrainConfig) -> str | None:
    """Return the next skill whose starts earn rewards, which the transitions of a training are kept for."""
    return config.agent.next_skill if config.agent.next_skill_reward else None


def _in_stage(config: TrainConfig, stage: StageConfig, number: int) -> TrainConfig:
    node = OmegaConf.create(dataclasses.asdict(train_config(config)))
    node.curriculum.stages = []
    node.agent.policy_steps = stage.policy_steps
    node.episode_seed += number * EPISODE_SEEDS
    for key, value in flat(stage.set):
        if _within(key, FIXED) or not _within(key, SETTABLE):
            raise ConfigError(f"{key} cannot change within a training; a stage sets values of {', '.join(SETTABLE)}")
        check_overrides("train", [override(key, value)])
        OmegaConf.update(node, key, value)
    changed = freeze(TrainConfig, node)
    if (changed.comfort.source == "none") != (config.comfort.source == "none"):
        raise ConfigError(f"comfort.source={changed.comfort.source} changes whether the policy sees the level")
    return changed


def _within(key: str, parts: tuple[str, ...]) -> bool:
    return any(f"{key}.".startswith(f"{part}.") for part in parts)


def flat(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the leaves of nested values by their dotted keys."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{before}{key}.")
        else:
            yield before + key, value


def with_budget(config: T, policy_steps: int) -> T:
    """Return `config` with another budget, which its stages share as before; a hierarchy's refinement grows with it."""
    values = dataclasses.asdict(config)
    steps = [stage.policy_steps for stage in config.curriculum.stages]
    begin = 0
    for index, stage in enumerate(values["curriculum"]["stages"]):
        end = round(policy_steps * sum(steps[: index + 1]) / sum(steps))
        stage["policy_steps"], begin = end - begin, end
    for stage in values["hierarchy"]["refinement"] if steps and "hierarchy" in values else ():
        stage["policy_steps"] = max(1, round(policy_steps / sum(steps) * stage["policy_steps"]))
    values["agent"]["policy_steps"] = policy_steps
    return section(type(config), values)
