"""Sort: pick, place and return for each of several balls, in whatever order they are aimed at.

Its stages are the cycle's, once a ball. Which ball is aimed at is the controller's to choose before each
pick; unless it does, the next of those that are left.
"""

from __future__ import annotations

from hrl_comfort.tasks import observations, rewards
from hrl_comfort.tasks.cycle import STAGES
from hrl_comfort.tasks.subtask import Subtask


def sort(balls: int) -> Subtask:
    """Return the subtask of sorting so many balls."""
    stages = STAGES * balls
    return Subtask(
        name="sort",
        stages=stages,
        observations=observations.standard(stages),
        rewards=rewards.standard(stages),
        start="home",
    )
