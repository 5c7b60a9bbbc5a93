"""Training in the batched cell: what `train` takes from the simulator and from other policies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from hrl_comfort.agents.policy import load_value
from hrl_comfort.compose import environment
from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.envs.torchrl import CellEnv
from hrl_comfort.experiments.stepper import Guide, Stepper, Steps, Successor
from hrl_comfort.experiments.stepper_apart import StepperApart
from hrl_comfort.experiments.stepper_process import StepperProcess
from hrl_comfort.experiments.train import train
from hrl_comfort.experiments.train_together import Turn, Why, train_together
from hrl_comfort.meta.options import make_policy, observed_by
from hrl_comfort.tasks import subtask

BEGINS = {"pick": "taken", "place": "left"}
"""A subtask's last stage -> where the subtask after it begins (`Subtask.start`)."""


def train_cell(config: TrainConfig, process: StepperProcess | None = None) -> Path:
    """Train in the batched cell; see `train` and `steps_of`."""
    return train(config, partial(steps_of, process=process))


def train_cells(configs: Sequence[TrainConfig], turn: Turn) -> Iterator[tuple[int, Why]]:
    """Train in batched cells, together, all in this process; see `train_together`."""
    return train_together(configs, stepper_of, turn)


def steps_of(config: TrainConfig, process: StepperProcess | None = None) -> Steps:
    """Return the cells that a training asks for, in a process of their own if `agent.cells_apart`.

    In `process`, if that has begun already; it ends with them.
    """
    if not config.agent.cells_apart:
        return stepper_of(config)
    return StepperApart(config, process or StepperProcess())


def stepper_of(config: TrainConfig) -> Stepper:
    """Return the cells that a training asks for, in this process.

    Raises:
        ConfigError: a choice is not allowed, or its guide or successor does not go with it.
    """
    env = CellEnv(environment(config), config.engine.rows, config.episode_seed)
    guide = None if config.agent.guide is None else guide_of(config, env)
    successor = None if config.agent.successor is None else successor_of(config, env)
    return Stepper(config.agent, env, guide, successor)


def guide_of(config: TrainConfig, env: CellEnv) -> Guide:
    """Return what acts in the guided rows of `env`.

    Raises:
        ConfigError: there is no such policy, or it does not go with this training.
    """
    source, episodes = config.agent.guide, env.engine.episodes
    rows = torch.arange(config.agent.guided_rows)
    assert source is not None
    if source == "random":
        raise ConfigError("agent.guide=random shows nothing; choose field, expert or a run folder")
    try:
        act = make_policy(source, episodes.subtask, env.engine.scene, environment(config), config.train_seed)
    except ConfigError as error:
        raise ConfigError(f"agent.guide={source}: {error}") from error

    def guide() -> Tensor:
        assert episodes.state is not None
        return act(episodes.state.rows(rows))

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
