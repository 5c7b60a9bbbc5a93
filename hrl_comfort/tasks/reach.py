"""Reach: bring the tool to one point, fixed or drawn for each episode."""

from __future__ import annotations

from functools import cache

from torch import Tensor

from hrl_comfort.tasks.standard import standard_subtask
from hrl_comfort.tasks.state import State
from hrl_comfort.tasks.subtask import Stage, tool_distance


@cache
def reach_point(index: int) -> Stage:
    """Return the stage that brings the tool within its tolerance of the episode's point `index` (0 or 1)."""

    def goal(state: State) -> Tensor:
        return state.points[..., index, :]

    distance = tool_distance(goal)

    def done(state: State) -> Tensor:
        return distance(state) < state.grasp_tolerance

    return Stage("reach", goal, distance, done, bonus="reach", at_point=True)


REACH = standard_subtask("reach", (reach_point(0),))
