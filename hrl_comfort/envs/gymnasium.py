"""Gymnasium fronts (extra `gymnasium`): one cell as an `Env`, N cells as a `VectorEnv`."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.envs.cells import RENDER_MODES, Array, Cells

Info = dict[str, Any]
Picture = NDArray[np.uint8]


class CellGym(gymnasium.Env[Array, Array]):
    """One cell; a step is a decision.

    Action (A,) in [-1, 1], observation (D,) float32. `info` holds the values of `step_columns`; `human_distance`
    is NaN without a human. `reset(seed=s)` starts the episodes of `hrl_comfort.load(task, seed=s)`; a reset without
    a seed starts the next one. `reset(options={"episode": 3, "split": "validation"})` replays an episode of an
    evaluation split.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": 10}  # noqa: RUF012

    def __init__(self, config: EnvConfig, render_mode: str | None = None) -> None:
        """Build the cell; `render_mode` is `rgb_array`, `human` (MuJoCo's viewer) or None."""
        self._front(Cells(config, 1, render_mode))

    def _front(self, cells: Any) -> None:
        self._cells = cells
        self.render_mode = cells.render_mode
        self.metadata = {**self.metadata, "render_fps": cells.frames_per_s}
        self.observation_space, self.action_space = cells.spaces

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Array, Info]:
        """Start an episode; raise ConfigError if `seed` or an option is not allowed."""
        super().reset(seed=seed)
        observation = self._cells.reset(seed, self.np_random, options)[0]
        return observation, {name: column[0] for name, column in self._cells.known().items()}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, Info]:
        """Run one decision.

        Raises:
          ValueError: `action` is not (A,) finite numbers.
          ResetNeeded: there is no episode yet.
        """
        _check_reset(self._cells)
        result, observation, values = self._cells.step(action, self.action_space.shape)
        info = {name: column[0].item() if column.ndim == 1 else column[0] for name, column in values.items()}
        ended = bool(result.terminated[0]), bool(result.truncated[0])
        return observation[0], float(result.reward[0]), *ended, info

    def render(self) -> Picture | None:  # type: ignore[override]
        """Return the picture (360, 480, 3) in mode `rgb_array`; the window of `human` needs no call.

        Raises:
          PicturesUnavailableError: there is no off-screen OpenGL.
          ResetNeeded: there is no episode yet.
        """
        _check_reset(self._cells)
        return self._cells.pictures()[0] if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Stop the engine's threads and the pictures."""
        self._cells.close()


class CellVector(gymnasium.vector.VectorEnv[Array, Array, NDArray[Any]]):
    """N cells stepped together; a row that ends restarts within the same step.

    Action (N, A) in [-1, 1], observation (N, D) float32; `info` as of `CellGym`, (N,) each. If a row ends, `info`
    also holds `final_obs` (N,) of (D,) or None and `final_info`, masked by `_final_obs` and `_final_info` (N,) bool.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"],
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }
    autoreset_mode = AutoresetMode.SAME_STEP

    def __init__(self, config: EnvConfig, num_envs: int, render_mode: str | None = None) -> None:
        """Build the cells.

        Raises:
          ConfigError: `num_envs` is not a whole number from 1 to 65536, or `render_mode` is neither None nor rgb_array.
        """
        self._front(Cells(config, num_envs, of_batch(render_mode)))

    def _front(self, cells: Any) -> None:
        self._cells = cells
        self.num_envs = cells.engine.num_envs
        self.render_mode = cells.render_mode
        self.metadata = {**self.metadata, "render_fps": cells.frames_per_s}
        self.single_observation_space, self.single_action_space = cells.spaces
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(self, *, seed: int | list[int | None] | None = None, options: Info | None = None) -> tuple[Array, Info]:
        """Start an episode in every row; the episodes of row r do not depend on the number of rows.

        `options={"episode": k, "split": ...}` replay episode k + r of a split in row r.

        Raises:
          ConfigError: `seed` is a list or not allowed, or an option is not.
        """
        if isinstance(seed, list):
            raise ConfigError(f"seed={seed} must be one number; it determines the episodes of all rows")
        super().reset(seed=seed)
        return self._cells.reset(seed, self.np_random, options), self._cells.known()

    def step(self, actions: Array) -> tuple[Array, NDArray[Any], NDArray[Any], NDArray[Any], Info]:
        """Run one decision in every row.

        Raises:
          ValueError: `actions` are not (N, A) finite numbers.
          ResetNeeded: there is no episode yet.
        """
        _check_reset(self._cells)
        result, observation, values = self._cells.step(actions, self.action_space.shape)
        info: Info = dict(values)
        done = result.done.numpy()
        if done.any():
            last: NDArray[Any] = np.full(self.num_envs, None, dtype=object)
            for row in np.flatnonzero(done):
                last[row] = observation[row].copy()
            final = {name: column.copy() for name, column in values.items()}
            final |= {f"_{name}": done.copy() for name in values}
            info |= {"final_obs": last, "_final_obs": done.copy(), "final_info": final, "_final_info": done.copy()}
            observation = self._cells.restart(np.flatnonzero(done))
            info |= self._cells.known()
        reward, terminated, truncated = (
            each.numpy().copy() for each in (result.reward, result.terminated, result.truncated)
        )
        return observation, reward, terminated, truncated, info

    def render(self) -> tuple[Picture, ...] | None:  # type: ignore[override]
        """Return a picture (360, 480, 3) of each cell in mode `rgb_array`; raise as `CellGym.render` does."""
        _check_reset(self._cells)
        return tuple(self._cells.pictures()) if self.render_mode == "rgb_array" else None

    def close_extras(self, **_: Any) -> None:
        """Stop the engine's threads and the pictures."""
        self._cells.close()


def of_batch(render_mode: str | None) -> str | None:
    """Return the render mode of a batch; raise ConfigError for `human`."""
    if render_mode == "human":
        raise ConfigError("render_mode='human' shows one cell; choose rgb_array for a batch")
    return render_mode


def _check_reset(cells: Cells) -> None:
    if not cells.ready:
        raise ResetNeeded("there is no episode yet: call reset before step and render")
