"""N cells as the Gymnasium and Stable-Baselines3 fronts step them: arrays in and out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import torch
from gymnasium import Space
from gymnasium.spaces import Box
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.comfort.terms import present
from hrl_comfort.config import CONTROL_STEP_S, EnvConfig
from hrl_comfort.config.checks import between, one_of
from hrl_comfort.config.constants import MAX_ENVS
from hrl_comfort.envs.columns import step_columns
from hrl_comfort.envs.inputs import SEEDS, checked_action, episode_seed, replayed, whole
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.view import View

Array = NDArray[np.float32]
RENDER_MODES = ("human", "rgb_array")


class Stepped(Protocol):
    """Result of a step, (N,) each."""

    @property
    def reward(self) -> Tensor:
        """Float64."""

    @property
    def terminated(self) -> Tensor:
        """Bool."""

    @property
    def truncated(self) -> Tensor:
        """Bool."""

    @property
    def done(self) -> Tensor:
        """Bool, terminated or truncated."""


class Cells:
    """N cells with their view; a copy or a pickle of them goes on where they are."""

    def __init__(self, config: EnvConfig, num_envs: int, render_mode: str | None = None) -> None:
        """Build the cells.

        Raises:
          ConfigError: `num_envs` or `render_mode` is not allowed.
        """
        if render_mode is not None:
            one_of("render_mode", render_mode, RENDER_MODES)
        count = whole("num_envs", num_envs)
        between("num_envs", count, 1, MAX_ENVS)
        engine = replace(config.engine, num_envs=count)
        self.config, self.render_mode = replace(config, engine=engine), render_mode
        self.seeded = False
        """Whether a seed has been given or drawn."""
        self.ready = False
        """Whether `reset` has been called."""
        self._build()
        self.width = self._observe().shape[1]
        self.action_dim = self.engine.episodes.action_dim
        self.engine.episodes.rewind()

    def _build(self) -> None:
        self.engine = Engine(self.config, self.config.engine.num_envs, 0)
        self.engine.reset()
        self._view = View(self.engine)

    @property
    def frames_per_s(self) -> float:
        """Decisions, and so pictures, a second of simulated time."""
        return round(1 / (CONTROL_STEP_S * self.config.task.action_repeat), 6)

    @property
    def spaces(self) -> tuple[Space[Any], Space[Any]]:
        """Spaces of an observation (D,) and of an action (A,) of one cell."""
        return Box(-np.inf, np.inf, (self.width,), np.float32), Box(-1.0, 1.0, (self.action_dim,), np.float32)

    def known(self) -> dict[str, NDArray[Any]]:
        """Return what is known at the start of an episode, by name."""
        return {}

    def reset(self, seed: int | None, rng: np.random.Generator, options: Mapping[str, Any] | None = None) -> Array:
        """Begin an episode in every row and return the observations (N, D).

        It is the next one, the first of `seed` if given, or the one of a split that `options` name (`inputs.replayed`).
        The first seed is random.

        Raises:
          ConfigError: the seed or an option is not allowed.
        """
        entries = replayed(options, self.engine.num_envs)
        if seed is None and not self.seeded:
            seed = int(rng.integers(SEEDS))
        if seed is not None:
            self.engine.episodes.rewind(episode_seed(seed))
        self.seeded = self.ready = True
        self.engine.reset(entries=entries)
        return self._seen()

    def step(self, action: object, shape: tuple[int, ...]) -> tuple[Stepped, Array, dict[str, NDArray[Any]]]:
        """Run a decision; return its result, the observations (N, D) and its values by name, (N,) each.

        `action` is (N, A), or what `shape` says. The values are those of `step_columns`, the distance NaN without a
        human.

        Raises:
          ValueError: the action is not finite numbers of `shape`.
        """
        result = self.engine.step(checked_action(action, shape).reshape(self.engine.num_envs, -1))
        columns = step_columns(result)
        columns["human_distance"] = columns["human_distance"].where(present(result.state.humans_pos), torch.nan)
        return result, self._seen(), {name: values.numpy().copy() for name, values in columns.items()}

    def restart(self, rows: NDArray[np.int64]) -> Array:
        """Begin the next episode of `rows` and return the observations (N, D) of every row."""
        self.engine.reset(rows)
        return self._seen()

    def _seen(self) -> Array:
        """Show the first cell if that is asked for, and return the observations (N, D)."""
        if self.render_mode == "human":
            self._view.show()
        return self._observe()

    def _observe(self) -> Array:
        episodes = self.engine.episodes
        observed: Array = episodes.observe().float().numpy()
        return observed.copy()

    def pictures(self) -> list[NDArray[np.uint8]]:
        """Return a picture (`scene.camera.HEIGHT`, WIDTH, 3) of each cell; raise as `View.picture` does."""
        return [self._view.picture(row) for row in range(self.engine.num_envs)]

    def close(self) -> None:
        """Stop the engine's threads and the pictures."""
        self._view.close()
        self.engine.close()

    def __getstate__(self) -> dict[str, Any]:
        kept = {name: value for name, value in vars(self).items() if name not in ("engine", "_view")}
        return kept | {"seed": self.engine.episodes.sampler.seed, "state": self.engine.state_dict()}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        seed, state = kept.pop("seed"), kept.pop("state")
        vars(self).update(kept)
        self._build()
        self.engine.episodes.rewind(seed)
        self.engine.load_state_dict(state)
        if not self.ready:
            self.engine.episodes.rewind()
