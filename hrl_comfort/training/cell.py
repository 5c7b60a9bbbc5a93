"""Training in the batched cell: what `train` takes from the simulator and from other policies."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.config.compose import environment
from hrl_comfort.envs.torchrl import CellEnv
from hrl_comfort.policies.actor import load_policy
from hrl_comfort.policies.load import make_policy, observed_by
from hrl_comfort.tasks import subtask
from hrl_comfort.training.collector import Collector, Demonstrator, NextSkillValue
from hrl_comfort.training.trainer import train

BEGINS = {"pick": "at_ball", "place": "at_drop"}
"""A subtask's last stage -> where the subtask after it begins (`Subtask.start`)."""


def train_cell(config: TrainConfig) -> Path:
    """Train in the batched cell; see `train`."""
    return train(config, make_collector)


def make_collector(config: TrainConfig) -> Collector:
    """Return the cells that a training asks for, in this process.

    Raises:
        ConfigError: a choice is not allowed, or its guide or successor does not go with it.
    """
    env = CellEnv(environment(config), config.engine.num_envs, config.episode_seed)
    demonstrator = None if config.agent.demonstrator is None else make_demonstrator(config, env)
    next_skill = None if config.agent.next_skill is None else make_next_skill_value(config, env)
    return Collector(config.agent, env, demonstrator, next_skill)


def make_demonstrator(config: TrainConfig, env: CellEnv) -> Demonstrator:
    """Return what acts in the guided rows of `env`.

    Raises:
        ConfigError: there is no such policy, or it does not go with this training.
    """
    source, episodes = config.agent.demonstrator, env.engine.episodes
    rows = torch.arange(config.agent.demonstrator_envs)
    assert source is not None
    if source == "random":
        raise ConfigError("agent.demonstrator=random shows nothing; choose field, expert or a run folder")
    try:
        act = make_policy(source, episodes.subtask, env.engine.scene, environment(config), config.train_seed)
    except ConfigError as error:
        raise ConfigError(f"agent.demonstrator={source}: {error}") from error

    def demonstrator() -> Tensor:
        assert episodes.state is not None
        return act(episodes.state.rows(rows))

    return demonstrator


def make_next_skill_value(config: TrainConfig, env: CellEnv) -> NextSkillValue:
    """Return the value of what `env` has come to, to the policy that takes over from this one.

    With it a success is no end: its target bootstraps on the next option's value, as one policy's would in
    the longer task, if both were trained with the same gamma and rewards, which is not checked. So a skill is
    paid for leaving the arm where the next one can go on.

    Raises:
        ConfigError: there is no such policy, it begins elsewhere, or it does not go with this training.
    """
    source = Path(config.agent.next_skill or "")
    try:
        policy = load_policy(source, critics=True)
        spec = policy.spec
        task = subtask(spec["task"], spec["environment"]["observation"], config.task.balls)
        seen = observed_by(policy, str(source), task, environment(config))
    except ConfigError as error:
        raise ConfigError(f"agent.next_skill={source}: {error}") from error
    own = subtask(config.task.name, config.task.observation, config.task.balls)
    if task.start != BEGINS.get(own.stages[-1].name):
        raise ConfigError(f"agent.next_skill={source}: {task.name} does not begin where {own.name} ends")

    def next_skill(success: Tensor) -> Tensor:
        values = torch.zeros(len(success))
        rows = success.nonzero()[:, 0]
        if len(rows):
            assert env.last is not None
            state = env.last.state.rows(rows)
            values[rows] = policy.value(seen.observe(state.with_(stage=torch.zeros_like(state.stage))).float())
        return values

    return next_skill
