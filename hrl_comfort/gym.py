"""Registration of every subtask with Gymnasium on import (extra `gymnasium`).

`gymnasium.make("hrl_comfort/Pick-v0", human="arc")` gives one cell,
`gymnasium.make_vec("hrl_comfort/Pick-v0", num_envs=64)` a batch.
"""

from __future__ import annotations

import gymnasium

from hrl_comfort import environment_of
from hrl_comfort.envs.gymnasium import CellGym, CellVector
from hrl_comfort.tasks import SUBTASKS


def make(task: str, **choices: object) -> CellGym:
    """Return `task` as a Gymnasium environment of one cell; `choices` as in `hrl_comfort.load`."""
    return CellGym(environment_of(task, choices))


def make_vec(task: str, num_envs: int = 1, **choices: object) -> CellVector:
    """Return `task` as a Gymnasium vector environment of `num_envs` cells in one batch."""
    return CellVector(environment_of(task, choices), num_envs)


IDS = {task: f"hrl_comfort/{task.title().replace('_', '')}-v0" for task in SUBTASKS if task != "sort"}
"""Gymnasium id of each subtask; `sort` is an environment of options (`hrl_comfort.hierarchy.option_env`)."""

for _task, _id in IDS.items():
    gymnasium.register(_id, f"{__name__}:make", vector_entry_point=f"{__name__}:make_vec", kwargs={"task": _task})

__all__ = ["IDS", "make", "make_vec"]
