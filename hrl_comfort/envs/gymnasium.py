"""Gymnasium fronts (extra `gymnasium`): one cell as an `Env`, N cells as a `VectorEnv`."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.comfort.metrics import present
from hrl_comfort.config import FIRST_SEED, ConfigError, EnvConfig
from hrl_comfort.envs.columns import step_columns
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.tasks import State

Array = NDArray[np.float32]
Info = dict[str, Any]


class _Cells:
    """N cells, shared by both fronts."""

    def __init__(self, config: EnvConfig, rows: int) -> None:
        self.engine = Engine(config, rows, 0)
        width = self.observe(self.engine.reset()).shape[-1]
        self.observation = Box(-np.inf, np.inf, (width,), np.float32)
        self.action = Box(-1.0, 1.0, (6,), np.float32)
        self._begun = False

    def reset(self, seed: int | None, rng: np.random.Generator) -> Array:
        """Start the next episode in every row, the first of `seed` if given; the first seed is random."""
        if seed is None and not self._begun:
            seed = int(rng.integers(FIRST_SEED))
        if seed is not None:
            if seed >= FIRST_SEED:
                raise ConfigError(
                    f"seed={seed} must be below {FIRST_SEED}; larger seeds are those of the evaluation set"
                )
            self.engine.episodes.sampler.seed = seed
            self.engine.episodes.rewind()
        self._begun = True
        return self.observe(self.engine.reset()).copy()

    def observe(self, state: State) -> Array:
        """Return the observations (N, D)."""
        observed: Array = self.engine.episodes.subtask.observe(state).float().numpy()
        return observed


def _info(outcome: StepResult) -> dict[str, Tensor]:
    """Return `step_columns`, with NaN for the distance without a human."""
    columns = step_columns(outcome)
    columns["human_distance"] = columns["human_distance"].where(present(outcome.state.human_pos), torch.nan)
    return columns


class CellGym(gymnasium.Env[Array, Array]):
    """One cell; a step is a decision.

    Action (6,) in [-1, 1], observation (D,) float32. `info` holds the values of `step_columns`; `human_distance`
    is NaN without a human. `reset(seed=s)` starts the episodes of `hrl_comfort.load(task, seed=s)`; a reset without
    a seed starts the next one.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(self, config: EnvConfig) -> None:
        self._cells = _Cells(config, 1)
        self.observation_space, self.action_space = self._cells.observation, self._cells.action

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Array, Info]:
        """Start an episode; raise ConfigError if `seed` is one of the evaluation set."""
        super().reset(seed=seed)
        return self._cells.reset(seed, self.np_random)[0], {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, Info]:
        """Run one decision."""
        outcome = self._cells.engine.step(np.asarray(action, dtype=np.float64)[None])
        info = {name: values[0].item() for name, values in _info(outcome).items()}
        observation = self._cells.observe(outcome.state)[0].copy()
        ended = bool(outcome.terminated[0]), bool(outcome.truncated[0])
        return observation, float(outcome.reward[0]), *ended, info

    def close(self) -> None:
        """Stop the engine's threads."""
        self._cells.engine.close()


class CellVector(gymnasium.vector.VectorEnv[Array, Array, NDArray[Any]]):
    """N cells stepped together; a row that ends restarts within the same step.

    Action (N, 6) in [-1, 1], observation (N, D) float32; `info` as of `CellGym`, (N,) each. If a row ends, `info`
    also holds `final_obs` (N,) of (D,) or None and `final_info`, masked by `_final_obs` and `_final_info` (N,) bool.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(self, config: EnvConfig, num_envs: int) -> None:
        self.num_envs = num_envs
        self._cells = _Cells(config, num_envs)
        self.single_observation_space, self.single_action_space = self._cells.observation, self._cells.action
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(self, *, seed: int | list[int | None] | None = None, options: Info | None = None) -> tuple[Array, Info]:
        """Start an episode in every row; the episodes of row r do not depend on the number of rows.

        Raises:
          ConfigError: `seed` is one of the evaluation set, or a list.
        """
        if isinstance(seed, list):
            raise ConfigError(f"seed={seed} must be one number; it determines the episodes of all rows")
        super().reset(seed=seed)
        return self._cells.reset(seed, self.np_random), {}

    def step(self, actions: Array) -> tuple[Array, NDArray[Any], NDArray[Any], NDArray[Any], Info]:
        """Run one decision in every row."""
        outcome = self._cells.engine.step(np.asarray(actions, dtype=np.float64))
        info: Info = {name: values.numpy().copy() for name, values in _info(outcome).items()}
        observation, done = self._cells.observe(outcome.state), outcome.done.numpy()
        if done.any():
            last = np.full(self.num_envs, None, dtype=object)
            for row in np.flatnonzero(done):
                last[row] = observation[row].copy()
            final = {name: values.copy() for name, values in info.items()}
            final |= {f"_{name}": done.copy() for name in info}
            info |= {"final_obs": last, "_final_obs": done.copy(), "final_info": final, "_final_info": done.copy()}
            observation = self._cells.observe(self._cells.engine.reset(np.flatnonzero(done)))
        reward, terminated, truncated = (
            each.numpy().copy() for each in (outcome.reward, outcome.terminated, outcome.truncated)
        )
        return observation.copy(), reward, terminated, truncated, info

    def close_extras(self, **_: Any) -> None:
        """Stop the engine's threads."""
        self._cells.engine.close()
