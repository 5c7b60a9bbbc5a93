"""Subtasks as values, by name."""

from dataclasses import replace

from hrl_comfort.config import ConfigError
from hrl_comfort.config.checks import one_of, part
from hrl_comfort.tasks.cycle import CYCLE, PICK_PLACE, sort
from hrl_comfort.tasks.observations import LAYOUTS
from hrl_comfort.tasks.pick import PICK
from hrl_comfort.tasks.place import PLACE
from hrl_comfort.tasks.reach import POINT_TO_POINT, REACH
from hrl_comfort.tasks.return_home import RETURN
from hrl_comfort.tasks.state import State
from hrl_comfort.tasks.subtask import Ball, Stage, Start, Subtask

SUBTASKS: dict[str, Subtask] = {
    task.name: task for task in (REACH, POINT_TO_POINT, PICK, PLACE, RETURN, PICK_PLACE, CYCLE, sort(1))
}


def subtask(name: str, observation: str = "default", balls: int = 1) -> Subtask:
    """Return the subtask `name`, seen through the observation layout `observation`.

    `name` is one of SUBTASKS, an entry point or `package.module:name`; `balls` counts for `sort` alone.

    Raises:
      ConfigError: no such subtask or layout.
    """
    found = part("task.name", name, SUBTASKS)
    if not isinstance(found, Subtask):
        raise ConfigError(f"task.name={name!r} is of type {type(found).__name__}; it must be a Subtask")
    one_of("task.observation", observation, tuple(LAYOUTS))
    chosen = sort(balls) if name == "sort" else found if found.name == name else replace(found, name=name)
    if observation == "default":
        return chosen
    return replace(chosen, observations=LAYOUTS[observation](chosen.stages))


__all__ = ["SUBTASKS", "Ball", "Stage", "Start", "State", "Subtask", "subtask"]
