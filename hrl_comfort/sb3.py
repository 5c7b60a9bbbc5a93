"""Stable-Baselines3 and sb3-contrib over the batched engine (extra `sb3`).

`make_vec_env("hrl_comfort/Pick-v0", 64)` is a `VecEnv` of 64 cells in one batch, with a `VecMonitor` around it. So is
`make_vec_env("hrl_comfort/Kitting-Options-v0", 64)`, whose actions are options.
"""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import Any

import numpy as np
from gymnasium import Wrapper
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecMonitor
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from hrl_comfort import environment_of, options_of
from hrl_comfort.config import ConfigError
from hrl_comfort.config.checks import one_of
from hrl_comfort.envs.cells import Array, Cells, Stepped
from hrl_comfort.envs.gymnasium import of_batch
from hrl_comfort.gym import IDS, OPTION_IDS
from hrl_comfort.hierarchy.option_cells import OptionCells


def make_vec_env(
    env_id: str,
    n_envs: int = 1,
    seed: int | None = None,
    render_mode: str | None = None,
    run: str | PathLike[str] | None = None,
    **choices: object,
) -> VecMonitor:
    """Return `n_envs` cells of `env_id` as a monitored `VecEnv`.

    Args:
      env_id: Gymnasium id, one of `hrl_comfort.gym.IDS` or OPTION_IDS.
      n_envs: number of cells, from 1 to 65536.
      seed: seed of the episodes of all cells; random by default.
      render_mode: `rgb_array` for pictures, or None.
      run: as of `hrl_comfort.load`.
      choices: as of `hrl_comfort.load`; of options also `gamma` and `observation`, as of `OptionGym`.

    Raises:
      ConfigError: an id, number, seed or choice that is not allowed.
      TypeError: an unknown keyword.
    """
    tasks = {each: task for ids in (IDS, OPTION_IDS) for task, each in ids.items()}
    name, mode = env_id.removeprefix("hrl_comfort.gym:"), of_batch(render_mode)
    one_of("env_id", name, tuple(tasks))
    cells: CellVecEnv
    if name in IDS.values():
        cells = CellVecEnv(Cells(environment_of(tasks[name], choices, run), n_envs, mode))
    else:
        own: dict[str, Any] = {key: choices.pop(key) for key in ("gamma", "observation") if key in choices}
        cells = OptionVecEnv(OptionCells(options_of(tasks[name], choices, run), n_envs, mode, **own))
    if seed is not None:
        cells.seed(seed)
    return VecMonitor(cells)


class CellVecEnv(VecEnv):
    """N cells as a `VecEnv`; a row that ends restarts within the same step.

    Action (N, A) in [-1, 1], observation (N, D) float32. The info of a row holds the values of `step_columns` and
    `is_success`; at the end of its episode also `terminal_observation` and `TimeLimit.truncated`.
    """

    def __init__(self, cells: Cells) -> None:
        self.cells = cells
        self._rng = np.random.default_rng()
        super().__init__(cells.engine.num_envs, *cells.spaces)
        self.metadata: dict[str, Any] = {**self.metadata, "render_fps": cells.frames_per_s}

    def reset(self) -> Array:
        """Begin an episode in every row, with the seed and the options set before; return the observations (N, D).

        The first of the seeds determines the episodes of all rows. The options of a row are an `episode` and a
        `split`, one split for all.

        Raises:
          ConfigError: the seed or an option is not allowed.
        """
        observation = self.cells.reset(self._seeds[0], self._rng, _merged(self._options))
        self._reset_seeds()
        self._reset_options()
        self.reset_infos = _of_rows(self.cells.known(), self.num_envs)
        return observation

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions (N, A) for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Run one decision in every row.

        Raises:
          RuntimeError: there is no episode yet.
          ValueError: the actions are not (N, A) finite numbers.
        """
        result, observation, values = self.cells.step(self._actions, (self.num_envs, *(self.action_space.shape or ())))
        infos = _of_rows({**values, "is_success": values["success"]}, self.num_envs)
        done = result.done.numpy()
        for row in np.flatnonzero(done):
            infos[row]["terminal_observation"] = observation[row].copy()
            infos[row]["TimeLimit.truncated"] = bool(result.truncated[row])
        if done.any():
            observation = self.cells.restart(np.flatnonzero(done))
            for info, known in zip(infos, _of_rows(self.cells.known(), self.num_envs), strict=True):
                info |= known
        return observation, self._rewards(result), done.copy(), infos

    def _rewards(self, result: Stepped) -> NDArray[np.float32]:
        return result.reward.float().numpy()  # type: ignore[no-any-return]

    def get_images(self) -> Sequence[NDArray[np.uint8]]:
        """Return a picture (360, 480, 3) of each cell; raise PicturesUnavailableError without off-screen OpenGL."""
        return self.cells.pictures()

    def close(self) -> None:
        """Stop the engine's threads and the pictures."""
        self.cells.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of the cells, which is the same for every row."""
        return [getattr(self.cells, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Raise AttributeError: the rows are one batch."""
        raise AttributeError(f"{attr_name} cannot be set: the rows are one batch; pass it to make_vec_env")

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        """Raise AttributeError: the rows are one batch."""
        raise AttributeError(f"{method_name} cannot be called on one row: the rows are one batch")

    def env_is_wrapped(self, wrapper_class: type[Wrapper], indices: VecEnvIndices = None) -> list[bool]:
        """Return False for every row."""
        return [False for _ in self._get_indices(indices)]


class OptionRewards(np.ndarray):
    """Rewards (N,) of options, with their durations, for `hrl_comfort.sb3_buffers`; a learner may add to them in place.

    Results of arithmetic with them have no durations.
    """

    plain: NDArray[np.float32]
    """(N,) the same, which nothing is added to."""
    duration: NDArray[np.int64]
    """(N,) control steps."""
    gamma: float | None = None
    """Discount factor of a control step within an option; None without durations."""

    def astype(self, *args: Any, **kwargs: Any) -> Any:
        """Return a copy of a type; of the same type with the durations: VecNormalize makes one of each reward."""
        found: Any = super().astype(*args, **kwargs)
        if self.gamma is not None and found.dtype == self.dtype:
            found.plain, found.duration, found.gamma = self.plain, self.duration, self.gamma
        return found


class OptionVecEnv(CellVecEnv):
    """N cells of which a step runs an option each, as `OptionVector`; `env_method("action_masks")` is for sb3-contrib.

    Actions (N,). The reward of an option, and what the info of a row holds, are as of `OptionGym`.
    """

    cells: OptionCells

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        """Return the masks (K,) of the rows for `action_masks`; raise AttributeError for anything else."""
        if method_name != "action_masks":
            return super().env_method(method_name, *args, indices=indices, **kwargs)
        masks = self.cells.action_masks()
        return [masks[row] for row in self._get_indices(indices)]

    def _rewards(self, result: Any) -> NDArray[np.float32]:
        plain = super()._rewards(result)
        rewards = plain.copy().view(OptionRewards)
        rewards.plain, rewards.duration, rewards.gamma = plain, result.duration.numpy(), self.cells.gamma
        return rewards


def _of_rows(columns: dict[str, NDArray[Any]], rows: int) -> list[dict[str, Any]]:
    """Return the values of each row by name, of columns (N, ...): a number of (N,), an array of others."""
    values = [column.tolist() if column.ndim == 1 else list(column) for column in columns.values()]
    return [dict(zip(columns, (each[row] for each in values), strict=True)) for row in range(rows)]


def _merged(options: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the options of all rows as those of a batch: one number `episode` a row, one `split`."""
    if not any(options):
        return {}
    first = options[0]
    for row, each in enumerate(options):
        if set(each) != {"episode", "split"} or each["split"] != first["split"]:
            raise ConfigError(f"options[{row}]={each!r}: every row takes an episode, and all the same split")
    return {"episode": [each["episode"] for each in options], "split": first["split"]}
