"""The comfort level as an observation and F_comfort as a reward term of a subtask."""

from dataclasses import replace

import torch
from torch import Tensor

from hrl_comfort.comfort.terms import comfort, forms, human_distance, present
from hrl_comfort.config import ComfortConfig
from hrl_comfort.tasks import State, Subtask
from hrl_comfort.tasks.subtask import TransitionFunction

TERM = "comfort"
"""Name of the reward term; its weight is `comfort.scale`."""


def with_comfort(task: Subtask, config: ComfortConfig, max_step_deg: float) -> Subtask:
    """Return `task` with the level as an observation and F_comfort as a reward; unchanged if source=none."""
    if config.source == "none":
        return task
    rewards = {**task.rewards, TERM: comfort_reward(config, max_step_deg)}
    return replace(with_level(task, config.levels), rewards=rewards)


def with_level(task: Subtask, levels: int) -> Subtask:
    """Return `task` with the level (N, 1) as its last observation, scaled from 0 (level 1) to 1 (level N_c)."""

    def level(state: State) -> Tensor:
        return ((state.level - 1) / (levels - 1))[:, None]

    return task.observing(level=level)


def comfort_reward(config: ComfortConfig, max_step_deg: float) -> TransitionFunction:
    """Return the reward term (N,) of one control step: F_comfort (Eq. 4), 0 without a human.

    Raises:
      ConfigError: a form or the threshold is not there.
    """
    forms(config)

    def term(before: State, after: State) -> Tensor:
        tool, avoidable = config.distance == "tool", config.distance == "avoidable"
        distance = human_distance(after.tcp_pos, after.humans_pos) if tool else after.arm_distance
        increment_deg = torch.rad2deg((after.joint_target - before.joint_target).abs().amax(dim=-1))
        home = after.home_distance if avoidable else None
        value = comfort(distance, increment_deg, after.level, max_step_deg, config, home)
        return torch.where(present(after.humans_pos), value, 0.0)

    return term


def max_episode_steps(level: Tensor, limit: int, config: ComfortConfig) -> Tensor:
    """Return the time limit (N,) in control steps at levels (N,).

    If beta > 0 it grows with 1 / threshold of F_conf2, so that an arm below the threshold has time to finish.
    """
    if config.source == "none" or config.beta == 0:
        return torch.full_like(level, limit, dtype=torch.int64)
    return torch.ceil(limit * config.levels / level).to(torch.int64)


def longest_max_episode_steps(limit: int, config: ComfortConfig) -> int:
    """Return the time limit at level 1, the longest, in control steps."""
    return int(max_episode_steps(torch.ones(1, dtype=torch.float64), limit, config))
