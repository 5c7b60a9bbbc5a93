"""Return: bring every joint back to home, from where a place ends."""

from __future__ import annotations

from torch import Tensor

from hrl_comfort.tasks.standard import standard_subtask
from hrl_comfort.tasks.state import State
from hrl_comfort.tasks.subtask import ObjectAt, Stage, Start


def goal(state: State) -> Tensor:
    """Return the tool centre point (N, 3) at home, m."""
    return state.tcp_home


def distance(state: State) -> Tensor:
    """Return the joint error (N,) summed over joints, rad. Angles are absolute: a full turn is not home."""
    return (state.joint_pos - state.joint_home).abs().sum(dim=-1)


def done(state: State) -> Tensor:
    """Return (N,) bool: every joint is within its tolerance of home."""
    error = (state.joint_pos - state.joint_home).abs().amax(dim=-1)
    return error < state.home_tolerance


RETURN_STAGE = Stage(
    "return",
    goal,
    distance,
    done,
    bonus="home",
    joint_space=True,
    object=ObjectAt.PLACE,
    object_after=ObjectAt.PLACE,
    next_start=Start.HOME,
)
RETURN = standard_subtask("return", (RETURN_STAGE,), Start.AT_PLACE)
