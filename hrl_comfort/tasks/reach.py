"""Reach: bring the tool to one point, fixed or drawn for each episode."""

from __future__ import annotations

from torch import Tensor
from torch.linalg import vector_norm

from hrl_comfort.tasks import observations, rewards
from hrl_comfort.tasks.state import State
from hrl_comfort.tasks.subtask import Stage, Subtask


def reach_point(index: int) -> Stage:
    """Return the stage that brings the tool within `take` of the episode's point `index` (0 or 1)."""

    def goal(state: State) -> Tensor:
        return state.points[:, index]

    def distance(state: State) -> Tensor:
        return vector_norm(state.points[:, index] - state.tcp_pos, dim=-1)

    def done(state: State) -> Tensor:
        return distance(state) < state.take

    return Stage("reach", goal, distance, done)


STAGES = (reach_point(0),)

REACH = Subtask(
    name="reach",
    stages=STAGES,
    observations=observations.standard(STAGES),
    rewards=rewards.standard(STAGES),
    start="home",
)
