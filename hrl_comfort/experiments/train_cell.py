"""Training in the batched cell: what `train` takes from the simulator and from other policies."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import torch
from torch import Tensor
from torchrl.envs import EnvBase

from hrl_comfort.agents.policy import load_value
from hrl_comfort.compose import environment
from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.envs.torchrl import CellEnv
from hrl_comfort.experiments.guide import SLOW, ActsApart, acting
from hrl_comfort.experiments.train import Guide, Successor, train
from hrl_comfort.experiments.train_together import Turn, Why, train_together
from hrl_comfort.meta.options import observed_by
from hrl_comfort.tasks import subtask

BEGINS = {"pick": "taken", "place": "left"}
"""A subtask's last stage -> where the subtask after it begins (`Subtask.start`)."""


def train_cell(config: TrainConfig) -> Path:
    """Train in the batched cell; see `train`."""
    return train(config, cell_of, guide_of, successor_of)


def train_cells(configs: Sequence[TrainConfig], turn: Turn) -> Iterator[tuple[int, Why]]:
    """Train in batched cells, together; see `train_together`."""
    return train_together(configs, cell_of, guide_of, successor_of, turn)


def cell_of(config: TrainConfig) -> EnvBase:
    """Return the cells that a training asks for."""
    return CellEnv(environment(config), config.engine.rows, config.episode_seed)


def guide_of(config: TrainConfig, env: CellEnv) -> Guide:
    """Return what acts in the guided rows of `env`.

    Raises:
        ConfigError: there is no such policy, or it does not go with this training.
    """
    episodes, rows = env.engine.episodes, torch.arange(config.agent.guided_rows)
    here = acting(config, env.engine.scene)
    apart = ActsApart(config) if config.agent.guide in SLOW else None

    def guide() -> Callable[[], Tensor]:
        assert episodes.state is not None
        state = episodes.state.rows(rows)
        return apart(state) if apart is not None else lambda: here(state)

    return guide


def successor_of(config: TrainConfig, env: CellEnv) -> Successor:
    """Return the value of what `env` has come to, to the policy that takes over from this one.

    With it a success is no end: its target bootstraps on the next option's value, as one policy's would in
    the longer task, if both were trained with the same gamma and rewards, which is not checked. So a skill is
    paid for leaving the arm where the next one can go on.

    Raises:
        ConfigError: there is no such policy, it begins elsewhere, or it does not go with this training.
    """
    source = Path(config.agent.successor or "")
    try:
        value = load_value(source)
        spec = value.policy.spec
        task = subtask(spec["task"], spec["meta"]["observation"], config.task.balls)
        seen = observed_by(value.policy, str(source), task, environment(config))
    except ConfigError as error:
        raise ConfigError(f"agent.successor={source}: {error}") from error
    own = subtask(config.task.name, config.task.observation, config.task.balls)
    if task.start != BEGINS.get(own.stages[-1].name):
        raise ConfigError(f"agent.successor={source}: {task.name} does not begin where {own.name} ends")

    def successor(success: Tensor) -> Tensor:
        values = torch.zeros(len(success))
        rows = success.nonzero()[:, 0]
        if len(rows):
            assert env.last is not None
            state = env.last.state.rows(rows)
            values[rows] = value(seen.observe(state.with_(stage=torch.zeros_like(state.stage))).float())
        return values

    return successor
