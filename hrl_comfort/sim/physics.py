"""Physics: from controls to readings. In batches by `mujoco.rollout`; `deploy.robot` has that of a real arm."""

from __future__ import annotations

from copy import copy
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import EnvConfig
from hrl_comfort.scene.workcell import CONTROL_SPEC, Scene
from hrl_comfort.sim.variation.bodies import vary
from hrl_comfort.sim.variation.randomisation import Values
from hrl_comfort.threads import Threads

Array = NDArray[np.float64]


class Physics(Protocol):
    """Cells that run controls, whoever made them."""

    state: Array
    """(N, nstate) mjSTATE_FULLPHYSICS: time, qpos, qvel."""

    @property
    def joints(self) -> Array:
        """(N, 2 J) as they are now: angles, rad, and velocities, rad/s."""

    def sense(self, rows: NDArray[np.int64], bodies: Array, control: Array, values: Values) -> Array:
        """Return the readings (r, nsensor) of `rows` (r,) if their bodies are at (r, nq + nv).

        They are under `control` (r, ncontrol), and their cells differ from the model by `values` (r).
        """

    def begin(self, rows: NDArray[np.int64], bodies: Array, values: Values) -> None:
        """Put the bodies of `rows` (r,) at (r, nq + nv); their cells differ from the model by `values` (r)."""

    def begin_decision(self) -> None:
        """Begin a decision, of which some control steps may turn out void."""

    def run(self, control: Array, rows: NDArray[np.int64] | None) -> Array:
        """Run `control` (r, T, ncontrol) in `rows` (r,), all by default; return the readings (r, T, nsensor)."""

    def end_decision(self, steps: NDArray[np.int64], rows: NDArray[np.int64] | None) -> None:
        """Go back to the physics step after the first `steps` (r,) of the decision."""

    def close(self) -> None:
        """Stop what runs beside."""


class Rollout:
    """N cells of one model, or of N whose bodies differ, in threads of MuJoCo."""

    def __init__(self, scene: Scene, config: EnvConfig, rows: int) -> None:
        self._scene = scene
        self.models = [copy(scene.model) for _ in range(rows if config.randomise.bodies else 0)]
        """One a row, where bodies differ from the model."""
        self._data = [mujoco.MjData(scene.model) for _ in range(config.engine.threads)]
        self._threads = Threads(config.engine.threads)
        self._passed: list[Array] = []
        """States (r, T, nstate) after each physics step of the decision."""
        self.state = np.zeros((rows, scene.nstate))

    @property
    def joints(self) -> Array:
        """See `Physics`."""
        return self._now.take(self._scene.moving, axis=1)

    @property
    def course(self) -> Array:
        """(N, 1 + T, nstate) states before the latest decision, of all rows, and after each of its physics steps."""
        return np.concatenate([self._begun[:, None], *self._passed], axis=1)

    def sense(self, rows: NDArray[np.int64], bodies: Array, control: Array, values: Values) -> Array:
        """See `Physics`. Readings are those before a step is integrated: to them, only sizes make a difference."""
        models = [self._scene.model] * len(control)
        if values.config.resized:
            models = [self.models[row] for row in rows]
            vary(models, self._scene, values)
        return self._rolled_out(models, state_of(bodies), np.ascontiguousarray(control[:, None]))[1][:, 0]

    def begin(self, rows: NDArray[np.int64], bodies: Array, values: Values) -> None:
        """See `Physics`."""
        self.state[rows] = state_of(bodies)
        if self.models:
            vary([self.models[row] for row in rows], self._scene, values)

    def begin_decision(self) -> None:
        """See `Physics`."""
        self._now, self._begun = self.state.copy(), self.state.copy()
        self._passed.clear()

    def run(self, control: Array, rows: NDArray[np.int64] | None) -> Array:
        """See `Physics`."""
        at = slice(None) if rows is None else rows
        models = [self._scene.model] * len(control)
        if self.models:
            models = self.models if rows is None else [self.models[row] for row in rows]
        states, sensed = self._rolled_out(models, self._now[at], control)
        self._now[at] = states[:, -1]
        self._passed.append(states)
        return sensed

    def _rolled_out(self, models: list[mujoco.MjModel], begin: Array, control: Array) -> tuple[Array, Array]:
        """Return states (r, T, nstate) and readings (r, T, nsensor) after T steps of `control` (r, T, ncontrol).

        The cells, one of each of `models`, are in the states `begin` (r, nstate) before.
        """
        n, steps = control.shape[:2]
        states, sensed = np.empty((n, steps, self._scene.nstate)), np.empty((n, steps, self._scene.model.nsensordata))
        # The checks of the shapes would take a sixth as long as one cell's physics.
        self._threads.rollout(
            models, self._data, begin, control, control_spec=CONTROL_SPEC, skip_checks=True, nstep=steps,
            state=states, sensordata=sensed,
        )  # fmt: skip
        return states, sensed

    def end_decision(self, steps: NDArray[np.int64], rows: NDArray[np.int64] | None) -> None:
        """See `Physics`."""
        whole, ends = sum(each.shape[1] for each in self._passed), self._passed[-1][:, -1].copy()
        early = np.flatnonzero(steps < whole)
        if len(early):
            course = np.concatenate([each[early] for each in self._passed], axis=1)
            ends[early] = course[np.arange(len(early)), steps[early] - 1]
        self.state[slice(None) if rows is None else rows] = ends

    def close(self) -> None:
        """See `Physics`."""
        self._threads.close()


def state_of(bodies: Array) -> Array:
    """Return the physics (r, nstate) at time 0 of bodies at (r, nq + nv); of an arm alone its joints (r, 2 J)."""
    return np.concatenate([np.zeros((len(bodies), 1)), bodies], axis=1)
