"""The engine: N cells stepped together by one physics, with partial resets."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.humans import EvaluationSet
from hrl_comfort.scene.workcell import Scene, scene_of
from hrl_comfort.sim.episodes import Episodes
from hrl_comfort.sim.physics import Physics, Rollout
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.sim.variation.random_streams import random_stream
from hrl_comfort.tasks import State

Array = NDArray[np.float64]

FUTURE_STREAM = 64
"""Stream of random numbers of futures, beside those of `sim.episode_sampler`."""


class Engine:
    """N cells: `reset` starts episodes, `step` runs a decision.

    Args are those of `Episodes`, and `physics`, which makes that of the cells from their scene.

    Raises:
      ConfigError: the rows are to be shared out over processes, which `sim.processes` does.
    """

    def __init__(
        self,
        config: EnvConfig,
        rows: int,
        seed: int,
        evaluation: EvaluationSet | None = None,
        measure_arm: bool = False,
        disturbance: str = "none",
        physics: Callable[[Scene, EnvConfig, int], Physics] = Rollout,
        **planning: Any,
    ) -> None:
        if min(config.engine.processes, rows) > 1:
            raise ConfigError(
                f"engine.processes={config.engine.processes} is for train, evaluate, benchmark, dataset and bench env; "
                "here choose engine.processes=1"
            )
        self.scene = scene_of(config)
        self.episodes = Episodes(self.scene, config, rows, seed, evaluation, measure_arm, disturbance, **planning)
        self.physics = physics(self.scene, config, rows)
        self.num_envs = rows
        self._alike: dict[str, Any] = {"disturbance": disturbance, "physics": physics, **planning}

    def reset(self, rows: NDArray[np.int64] | None = None, entries: EvaluationSet | None = None) -> State:
        """Begin the next episode of `rows` (all by default) and return the state of every row.

        With `entries` (r,) of an evaluation split the rows begin these; see `Episodes.begin`.
        """
        rows = np.arange(self.num_envs) if rows is None else rows
        if len(rows):
            bodies = self.episodes.begin(rows, self.physics.sense, entries)
            self.physics.begin(rows, bodies, self.episodes.values(rows))
        assert self.episodes.state is not None
        return self.episodes.state

    def step(self, action: Array, rows: NDArray[np.int64] | None = None) -> StepResult:
        """Run one decision, action (N, A) in [-1, 1], and return its result.

        If `rows` (r,) are given, only these are run; the others are void in the result and must be reset
        before they are stepped again.

        Raises:
          RuntimeError: a row has no episode yet.
          ValueError: the actions are of another shape, or there are no rows, with which MuJoCo would crash.
        """
        if rows is not None and not len(rows):
            raise ValueError("rows=[] is not allowed; name at least one row")
        at, physics = slice(None) if rows is None else rows, self.physics
        physics.begin_decision()
        controls = self.episodes.controls(action, lambda: physics.joints)
        sensed = [physics.run(control[at], rows) for control in controls]
        result = self.episodes.advance(sensed[0] if len(sensed) == 1 else np.concatenate(sensed, axis=1), rows)
        physics.end_decision(result.decision_steps.numpy()[at] * self.episodes.config.substeps, rows)
        self.episodes.lay(result, physics.state)
        return result

    def observe(self) -> Tensor:
        """Return the observations (N, D) of the cells as they are now."""
        return self.episodes.observe()

    @property
    def physics_state(self) -> Array:
        """(N, nstate) of the cells as they are now."""
        return self.physics.state

    @contextmanager
    def held(self, rows: Tensor) -> Iterator[None]:
        """Keep the cells of `rows` (r,) int64 as they are while others are stepped."""
        kept = of_rows(self.state_dict(), rows)
        yield
        self.load_state_dict(with_rows(self.state_dict(), rows, kept))

    def close(self) -> None:
        """Stop the threads, and listening to live levels."""
        self.physics.close()
        self.episodes.source.close()

    def copies(self, rows: Tensor, futures: Tensor | None = None) -> Engine:
        """Return an engine of r cells that go on as those of `rows` (r,) int64 would, to the end of their episodes.

        With `futures` (r,) int64 as they might; see `redraw`.
        """
        engine = Engine(self.episodes.config, len(rows), 0, **self._alike)
        engine.load_state_dict(of_rows(self.state_dict(), rows))
        if futures is not None:
            redraw(engine.episodes, futures.numpy())
        return engine

    def state_dict(self) -> dict[str, Any]:
        """Return what an exact continuation needs."""
        return {"physics": torch.from_numpy(self.physics.state.copy()), "episodes": self.episodes.state_dict()}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self.episodes.load_state_dict(saved["episodes"])
        rows, state = np.arange(self.num_envs), saved["physics"].numpy()
        self.physics.begin(rows, state[:, 1:], self.episodes.values())
        self.physics.state[:] = state


def redraw(episodes: Episodes, futures: NDArray[np.int64]) -> None:
    """Let the rest of the episodes of N cells be that of the `futures` (N,): people move, and orders come, otherwise.

    Cells at one step of one episode have the same future of a number. Who people are stays.
    """
    assert episodes.state is not None
    draw, steps = episodes.draw, episodes.state.steps.tolist()
    stays = np.empty(draw.noise.shape[::2])
    for row, (now, future) in enumerate(zip(steps, futures.tolist(), strict=True)):
        rng = random_stream(int(draw.key[row]), (FUTURE_STREAM << 48) + (now << 16) + future)
        later = draw.noise[row, now:]
        later[:] = rng.random(later.shape)
        order = rng.permutation(len(draw.due[row]))
        draw.arriving[row], draw.due[row] = draw.arriving[row, order], draw.due[row, order]
        stays[row] = rng.random(len(stays[row]))
    episodes.people.redraw_stays(stays)


def with_rows(saved: Any, rows: Tensor, theirs: Any) -> Any:
    """Return what was `saved` with `theirs` in the `rows` (r,) int64; see `of_rows`."""
    if isinstance(saved, dict):
        return {name: with_rows(each, rows, theirs[name]) for name, each in saved.items()}
    if isinstance(saved, list):
        return [with_rows(each, rows, other) for each, other in zip(saved, theirs, strict=True)]
    return saved.index_copy(0, rows, theirs) if isinstance(saved, Tensor) else saved


def of_rows(saved: Any, rows: Tensor) -> Any:
    """Return what was `saved`, in dictionaries and lists, of `rows` (r,) int64 alone: every tensor has rows first."""
    if isinstance(saved, dict):
        return {name: of_rows(each, rows) for name, each in saved.items()}
    if isinstance(saved, list):
        return [of_rows(each, rows) for each in saved]
    return saved[rows] if isinstance(saved, Tensor) else saved
