"""Place: carry the object to where its kind belongs, from where a pick ends."""

from __future__ import annotations

from torch import Tensor

from hrl_comfort.tasks.standard import standard_subtask
from hrl_comfort.tasks.state import State
from hrl_comfort.tasks.subtask import ObjectAt, Stage, Start, tool_distance


def goal(state: State) -> Tensor:
    """Return where the centre of the object (N, 3) belongs, m."""
    return state.target_place


distance = tool_distance(goal)


def done(state: State) -> Tensor:
    """Return (N,) bool: the tool, and with it the object, is within its tolerance of the goal."""
    return distance(state) < state.place_tolerance


PLACE_STAGE = Stage(
    "place",
    goal,
    distance,
    done,
    bonus="place",
    object=ObjectAt.TOOL,
    object_after=ObjectAt.PLACE,
    next_start=Start.AT_PLACE,
)
PLACE = standard_subtask("place", (PLACE_STAGE,), Start.AT_OBJECT)
PLACE_FINE = standard_subtask("place_fine", (PLACE_STAGE,), Start.AT_OBJECT)
"""Within millimetres, as into a slot that leaves the object some play."""
