"""Sort: the cycle's stages for each of several balls.

The meta-controller chooses the ball before each pick; without a choice it is the next one left.
"""

from __future__ import annotations

from hrl_comfort.tasks.cycle import CYCLE
from hrl_comfort.tasks.standard import standard_subtask
from hrl_comfort.tasks.subtask import Subtask


def sort(balls: int) -> Subtask:
    """Return the subtask of sorting `balls` balls."""
    return standard_subtask("sort", CYCLE.stages * balls)
