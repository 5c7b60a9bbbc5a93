"""Registration of every subtask with Gymnasium on import (extra `gymnasium`).

`gymnasium.make("hrl_comfort/Pick-v0", human="arc")` gives one cell,
`gymnasium.make_vec("hrl_comfort/Pick-v0", num_envs=64)` a batch, and `run="runs/demo/pick"` in either the environment
in which the policy of that run was trained. `"hrl_comfort/Kitting-Options-v0"` has options as actions. Without an
import of this module the id is `"hrl_comfort.gym:hrl_comfort/Pick-v0"`.
"""

from __future__ import annotations

from os import PathLike

import gymnasium

from hrl_comfort import environment_of, options_of
from hrl_comfort.config import SORTING
from hrl_comfort.envs.gymnasium import CellGym, CellVector
from hrl_comfort.hierarchy.option_cells import OptionGym, OptionVector
from hrl_comfort.tasks import SUBTASKS


class TaskEnv(CellGym):
    """A subtask by name as an environment of one cell; `run` and `choices` as in `hrl_comfort.load`."""

    def __init__(
        self, task: str, render_mode: str | None = None, run: str | PathLike[str] | None = None, **choices: object
    ) -> None:
        """Build the cell.

        Raises:
          ConfigError: a choice is not allowed, or `run` is of another task.
          TypeError: an unknown keyword.
        """
        super().__init__(environment_of(task, choices, run), render_mode)


class TaskVectorEnv(CellVector):
    """A subtask by name as a vector environment of `num_envs` cells in one batch; the rest is as of `TaskEnv`."""

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        render_mode: str | None = None,
        run: str | PathLike[str] | None = None,
        **choices: object,
    ) -> None:
        """Build the cells; raise as `TaskEnv` does, and ConfigError for a `num_envs` that is not allowed."""
        super().__init__(environment_of(task, choices, run), num_envs, render_mode)


class OptionTaskEnv(OptionGym):
    """A task by name whose actions are options; `run` and `choices` as of `hrl_comfort.options_of`."""

    def __init__(
        self,
        task: str,
        render_mode: str | None = None,
        run: str | PathLike[str] | None = None,
        gamma: float = 1.0,
        observation: str | None = None,
        **choices: object,
    ) -> None:
        """Build the cell; raise as `hrl_comfort.options_of` and `OptionGym` do."""
        super().__init__(options_of(task, choices, run), render_mode, gamma, observation)


class OptionTaskVectorEnv(OptionVector):
    """A task by name as a vector environment of `num_envs` cells; the rest is as of `OptionTaskEnv`."""

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        render_mode: str | None = None,
        run: str | PathLike[str] | None = None,
        gamma: float = 1.0,
        observation: str | None = None,
        **choices: object,
    ) -> None:
        """Build the cells; raise as `OptionTaskEnv` does, and ConfigError for a `num_envs` that is not allowed."""
        super().__init__(options_of(task, choices, run), num_envs, render_mode, gamma, observation)


IDS = {task: f"hrl_comfort/{task.title().replace('_', '')}-v0" for task in SUBTASKS if task not in SORTING}
"""Gymnasium id of each subtask."""
OPTION_IDS = {task: f"hrl_comfort/{task.title()}-Options-v0" for task in SORTING}
"""Gymnasium id of each task whose actions are options."""

for _ids, _name in ((IDS, "Task"), (OPTION_IDS, "OptionTask")):
    for _task, _id in _ids.items():
        gymnasium.register(
            _id,
            f"{__name__}:{_name}Env",
            vector_entry_point=f"{__name__}:{_name}VectorEnv",
            kwargs={"task": _task},
        )

__all__ = ["IDS", "OPTION_IDS", "OptionTaskEnv", "OptionTaskVectorEnv", "TaskEnv", "TaskVectorEnv"]
