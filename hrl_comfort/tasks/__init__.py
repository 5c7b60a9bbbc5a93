"""Subtasks as values, by name."""

from __future__ import annotations

from dataclasses import replace

from hrl_comfort.config import ConfigError
from hrl_comfort.config.checks import part
from hrl_comfort.tasks.cycle import CYCLE, PICK_PLACE
from hrl_comfort.tasks.hand import with_hand
from hrl_comfort.tasks.kitting import KITTING
from hrl_comfort.tasks.observations import LAYOUTS
from hrl_comfort.tasks.pick import PICK
from hrl_comfort.tasks.place import PLACE, PLACE_FINE
from hrl_comfort.tasks.point_to_point import POINT_TO_POINT
from hrl_comfort.tasks.reach import REACH
from hrl_comfort.tasks.return_home import RETURN
from hrl_comfort.tasks.shift import SHIFT, repeated
from hrl_comfort.tasks.sort import sort
from hrl_comfort.tasks.state import State
from hrl_comfort.tasks.subtask import ObjectAt, Stage, Start, Subtask

SUBTASKS: dict[str, Subtask] = {
    task.name: task
    for task in (REACH, POINT_TO_POINT, PICK, PLACE, PLACE_FINE, RETURN, PICK_PLACE, CYCLE, sort(1), SHIFT, KITTING)
}


def subtask(name: str, observation: str = "default", objects: int = 1, hand: bool = False) -> Subtask:
    """Return the subtask `name`, seen through the observation layout `observation`.

    `name` is one of SUBTASKS, an entry point or `package.module:name`; `objects` counts for `sort` alone. `hand`: of a
    cell with a gripper.

    Raises:
      ConfigError: no such subtask or layout.
    """
    found = part("task.name", name, SUBTASKS)
    if not isinstance(found, Subtask):
        raise ConfigError(f"task.name={name!r} is of type {type(found).__name__}; it must be a Subtask")
    if observation not in LAYOUTS:
        raise ConfigError(f"task.observation={observation!r} is not allowed; choose one of {', '.join(LAYOUTS)}")
    chosen = sort(objects) if name == "sort" else found if found.name == name else replace(found, name=name)
    if observation != "default":
        seen = replace(chosen, observations=LAYOUTS[observation](chosen.stages))
        chosen = replace(seen, observations=repeated(seen).observations) if chosen.repeats else seen
    return with_hand(chosen) if hand else chosen


__all__ = ["SUBTASKS", "ObjectAt", "Stage", "Start", "State", "Subtask", "subtask"]
