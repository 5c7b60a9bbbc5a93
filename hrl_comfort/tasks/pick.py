"""Pick: bring the tool to the ball, from home."""

from __future__ import annotations

from torch import Tensor
from torch.linalg import vector_norm

from hrl_comfort.tasks import observations, rewards
from hrl_comfort.tasks.state import State
from hrl_comfort.tasks.subtask import Stage, Subtask


def goal(state: State) -> Tensor:
    """Return the ball's position (N, 3), m."""
    return state.ball_pos


def distance(state: State) -> Tensor:
    """Return the distance (N,) from tool centre point to ball, m."""
    return vector_norm(state.ball_pos - state.tcp_pos, dim=-1)


def done(state: State) -> Tensor:
    """Return (N,) bool: the tool is within `take` of the ball, which then rides on the gripper."""
    return distance(state) < state.take


TAKE = Stage("pick", goal, distance, done)
STAGES = (TAKE,)

PICK = Subtask(
    name="pick",
    stages=STAGES,
    observations=observations.standard(STAGES),
    rewards=rewards.standard(STAGES),
    start="home",
)
