"""Place: carry the ball to the drop point of its colour, from where a pick ends."""

from __future__ import annotations

from torch import Tensor
from torch.linalg import vector_norm

from hrl_comfort.tasks import observations, rewards
from hrl_comfort.tasks.state import State
from hrl_comfort.tasks.subtask import Stage, Subtask


def goal(state: State) -> Tensor:
    """Return the drop point (N, 3) of the ball's colour, m."""
    return state.drop_pos


def distance(state: State) -> Tensor:
    """Return the distance (N,) from tool centre point to drop point, m."""
    return vector_norm(state.drop_pos - state.tcp_pos, dim=-1)


def done(state: State) -> Tensor:
    """Return (N,) bool: the tool, and so the ball, is within `leave` of the drop point."""
    return distance(state) < state.leave


LEAVE = Stage("place", goal, distance, done)
STAGES = (LEAVE,)

PLACE = Subtask(
    name="place",
    stages=STAGES,
    observations=observations.standard(STAGES),
    rewards=rewards.standard(STAGES),
    start="at_ball",
)
