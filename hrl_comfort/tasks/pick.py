"""Pick: bring the tool to the object, from home."""

from __future__ import annotations

from torch import Tensor

from hrl_comfort.tasks.standard import standard_subtask
from hrl_comfort.tasks.state import State
from hrl_comfort.tasks.subtask import ObjectAt, Stage, Start, tool_distance


def goal(state: State) -> Tensor:
    """Return the centre of the object (N, 3), m."""
    return state.target_object


distance = tool_distance(goal)


def done(state: State) -> Tensor:
    """Return (N,) bool: the tool is within its tolerance of the object, which then rides on the gripper."""
    return distance(state) < state.grasp_tolerance


PICK_STAGE = Stage(
    "pick",
    goal,
    distance,
    done,
    bonus="pick",
    object=ObjectAt.ARRIVAL,
    object_after=ObjectAt.TOOL,
    next_start=Start.AT_OBJECT,
)
PICK = standard_subtask("pick", (PICK_STAGE,))
