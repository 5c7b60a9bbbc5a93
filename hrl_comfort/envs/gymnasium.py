"""The Gymnasium fronts: one cell as an `Env`, N cells as a `VectorEnv`. Needs the extra `gymnasium`."""

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
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.tasks import State

Array = NDArray[np.float32]
Info = dict[str, Any]


class _Cells:
    """The N cells behind both fronts."""

    def __init__(self, config: EnvConfig, rows: int) -> None:
        self.engine = Engine(config, rows, 0)
        width = self.observe(self.engine.reset()).shape[-1]
        self.observation = Box(-np.inf, np.inf, (width,), np.float32)
        self.action = Box(-1.0, 1.0, (6,), np.float32)
        self._begun = False

    def reset(self, seed: int | None, rng: np.random.Generator) -> Array:
        """Begin the next episode in every row, the first of `seed` if given; the first of all is drawn."""
        if seed is None and not self._begun:
            seed = int(rng.integers(FIRST_SEED))
        if seed is not None:
            if seed >= FIRST_SEED:
                raise ConfigError(f"seed={seed} must be below {FIRST_SEED}, where those of evaluation begin")
            self.engine.episodes.draws.seed = seed
            self.engine.episodes.rewind()
        self._begun = True
        return self.observe(self.engine.reset()).copy()

    def observe(self, state: State) -> Array:
        """Return the observations (N, D)."""
        observed: Array = self.engine.episodes.subtask.observe(state).float().numpy()
        return observed


def _columns(outcome: StepResult) -> dict[str, Tensor]:
    """Return what `info` tells of a decision, each (N,)."""
    state, valid = outcome.state, outcome.valid
    distance = torch.where(valid, outcome.human_distance, 0.0).sum(dim=1) / outcome.decision_steps
    distance = torch.where(present(state.human_pos), distance, torch.nan)
    return {
        "success": outcome.success,
        "human_collision": state.human_collision,
        "other_collision": state.table_collision | state.self_collision,
        "steps": state.steps,
        "decision_steps": outcome.decision_steps,
        "human_distance": distance,
    }


class CellGym(gymnasium.Env[Array, Array]):
    """One cell; a step is a decision.

    Action (6,) in [-1, 1], observation (D,) float32. `info` of a step: `success`, `human_collision`,
    `other_collision` (bool); `steps`, `decision_steps`, control steps in the episode and in the decision;
    `human_distance`, m, its mean over the decision, NaN where nobody is there. `reset(seed=s)` begins the
    episodes of seed s, the same as those of `hrl_comfort.load(task, seed=s)`; a reset without a seed goes on
    with the next of them.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(self, config: EnvConfig) -> None:
        self._cells = _Cells(config, 1)
        self.observation_space, self.action_space = self._cells.observation, self._cells.action

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Array, Info]:
        """Begin an episode.

        Raises:
          ConfigError: `seed` is one of those kept for evaluation.
        """
        super().reset(seed=seed)
        return self._cells.reset(seed, self.np_random)[0], {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, Info]:
        """Run one decision."""
        outcome = self._cells.engine.step(np.asarray(action, dtype=np.float64)[None])
        info = {name: values[0].item() for name, values in _columns(outcome).items()}
        observation = self._cells.observe(outcome.state)[0].copy()
        ended = bool(outcome.terminated[0]), bool(outcome.truncated[0])
        return observation, float(outcome.reward[0]), *ended, info

    def close(self) -> None:
        """Stop the engine's threads."""
        self._cells.engine.close()


class CellVector(gymnasium.vector.VectorEnv[Array, Array, NDArray[Any]]):
    """N cells stepped together; a row that has ended begins anew within the same step.

    Action (N, 6) in [-1, 1], observation (N, D) float32; `info` as of `CellGym`, each (N,), and where a row
    has ended its last observation, `final_obs` (N,) of (D,) or None, and `final_info`, marked by `_final_obs`
    and `_final_info` (N,) bool.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(self, config: EnvConfig, num_envs: int) -> None:
        self.num_envs = num_envs
        self._cells = _Cells(config, num_envs)
        self.single_observation_space, self.single_action_space = self._cells.observation, self._cells.action
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(self, *, seed: int | list[int | None] | None = None, options: Info | None = None) -> tuple[Array, Info]:
        """Begin an episode in every row; row r of seed s is the same however many rows there are.

        Raises:
          ConfigError: `seed` is one of those kept for evaluation, or a list: one seed gives all rows theirs.
        """
        if isinstance(seed, list):
            raise ConfigError(f"seed={seed} must be one number; every row's episodes follow from it")
        super().reset(seed=seed)
        return self._cells.reset(seed, self.np_random), {}

    def step(self, actions: Array) -> tuple[Array, NDArray[Any], NDArray[Any], NDArray[Any], Info]:
        """Run one decision in every row."""
        outcome = self._cells.engine.step(np.asarray(actions, dtype=np.float64))
        info: Info = {name: values.numpy().copy() for name, values in _columns(outcome).items()}
        observation, done = self._cells.observe(outcome.state), outcome.done.numpy()
        if done.any():
            last = np.full(self.num_envs, None, dtype=object)
            for row in np.flatnonzero(done):
                last[row] = observation[row].copy()
            told = {name: values.copy() for name, values in info.items()}
            info |= {"final_obs": last, "_final_obs": done.copy()}
            info |= {
                "final_info": told | {f"_{name}": done.copy() for name in told},
                "_final_info": done.copy(),
            }
            observation = self._cells.observe(self._cells.engine.reset(np.flatnonzero(done)))
        reward = outcome.reward.numpy().copy()
        return (
            observation.copy(),
            reward,
            outcome.terminated.numpy().copy(),
            outcome.truncated.numpy().copy(),
            info,
        )

    def close_extras(self, **_: Any) -> None:
        """Stop the engine's threads."""
        self._cells.engine.close()
