"""Place: carry the ball to the drop point of its colour, from where a pick ends."""

from torch import Tensor

from hrl_comfort.tasks.standard import standard_subtask
from hrl_comfort.tasks.state import State
from hrl_comfort.tasks.subtask import Ball, Stage, Start, tool_distance


def goal(state: State) -> Tensor:
    """Return the drop point (N, 3) of the ball's colour, m."""
    return state.drop_pos


distance = tool_distance(goal)


def done(state: State) -> Tensor:
    """Return (N,) bool: the tool, and with it the ball, is within its tolerance of the drop point."""
    return distance(state) < state.place_tolerance


PLACE_STAGE = Stage(
    "place", goal, distance, done, bonus="place", ball=Ball.TOOL, ball_after=Ball.DROP, next_start=Start.AT_DROP
)
PLACE = standard_subtask("place", (PLACE_STAGE,), Start.AT_BALL)
