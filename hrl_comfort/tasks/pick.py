"""Pick: bring the tool to the ball, from home."""

from torch import Tensor

from hrl_comfort.tasks.standard import standard_subtask
from hrl_comfort.tasks.state import State
from hrl_comfort.tasks.subtask import Ball, Stage, Start, tool_distance


def goal(state: State) -> Tensor:
    """Return the ball's position (N, 3), m."""
    return state.ball_pos


distance = tool_distance(goal)


def done(state: State) -> Tensor:
    """Return (N,) bool: the tool is within its tolerance of the ball, which then rides on the gripper."""
    return distance(state) < state.grasp_tolerance


PICK_STAGE = Stage(
    "pick", goal, distance, done, bonus="pick", ball=Ball.TABLE, ball_after=Ball.TOOL, next_start=Start.AT_BALL
)
PICK = standard_subtask("pick", (PICK_STAGE,))
