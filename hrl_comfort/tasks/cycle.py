"""Sequences of pick, place and return, by one network or by a chain of options."""

from hrl_comfort.tasks.pick import PICK_STAGE
from hrl_comfort.tasks.place import PLACE_STAGE
from hrl_comfort.tasks.return_home import RETURN_STAGE
from hrl_comfort.tasks.standard import standard_subtask
from hrl_comfort.tasks.subtask import Subtask

PICK_PLACE = standard_subtask("pick_place", (PICK_STAGE, PLACE_STAGE))
"""Pick and place in one network: the paper's own division."""
CYCLE = standard_subtask("cycle", (PICK_STAGE, PLACE_STAGE, RETURN_STAGE))


def sort(balls: int) -> Subtask:
    """Return the subtask of sorting `balls` balls: the cycle's stages for each of them.

    The meta-controller chooses the ball before each pick; without a choice it is the next one left.
    """
    return standard_subtask("sort", CYCLE.stages * balls)
