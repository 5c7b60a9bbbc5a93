"""Return: bring every joint back to home, from where a place ends."""

from __future__ import annotations

from torch import Tensor

from hrl_comfort.tasks import observations, rewards
from hrl_comfort.tasks.state import State
from hrl_comfort.tasks.subtask import Stage, Subtask


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


GO_HOME = Stage("return", goal, distance, done)
STAGES = (GO_HOME,)

RETURN = Subtask(
    name="return",
    stages=STAGES,
    observations=observations.standard(STAGES),
    rewards=rewards.standard(STAGES),
    start="at_drop",
)
