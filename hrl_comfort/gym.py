"""Registers every subtask with Gymnasium when it is imported (extra `gymnasium`).

Then `gymnasium.make("hrl_comfort/Pick-v0", human="arc")` is one cell, and
`gymnasium.make_vec("hrl_comfort/Pick-v0", num_envs=64)` a batch of them.
"""

from __future__ import annotations

from typing import Any

import gymnasium

from hrl_comfort import environment_of
from hrl_comfort.envs.gymnasium import CellGym, CellVector
from hrl_comfort.tasks import SUBTASKS


def make(task: str, **choices: object) -> CellGym:
    """Return `task` as a Gymnasium environment of one cell; `choices` as of `hrl_comfort.load`."""
    return CellGym(environment_of(task, choices))


def make_vec(task: str, num_envs: int = 1, **choices: object) -> CellVector:
    """Return `task` as a Gymnasium vector environment of `num_envs` cells in one batch."""
    return CellVector(environment_of(task, choices), num_envs)


def _name(task: str) -> str:
    return "".join(word.capitalize() for word in task.split("_"))


IDS = {task: f"hrl_comfort/{_name(task)}-v0" for task in SUBTASKS if task != "sort"}
"""Subtask -> its id; `sort` is for controllers (`hrl_comfort.hierarchy.option_env`)."""

for _task, _id in IDS.items():
    _where: dict[str, Any] = {
        "entry_point": "hrl_comfort.gym:make",
        "vector_entry_point": "hrl_comfort.gym:make_vec",
    }
    gymnasium.register(_id, kwargs={"task": _task}, **_where)

__all__ = ["IDS", "make", "make_vec"]
