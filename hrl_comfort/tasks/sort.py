"""Sort: the cycle's stages for each of several objects.

The meta-controller chooses the object before each pick; without a choice it is the next one left.
"""

from __future__ import annotations

from hrl_comfort.tasks.cycle import CYCLE
from hrl_comfort.tasks.standard import standard_subtask
from hrl_comfort.tasks.subtask import Subtask


def sort(objects: int) -> Subtask:
    """Return the subtask of sorting `objects` objects."""
    return standard_subtask("sort", CYCLE.stages * objects)
