"""Speeds that the shield leaves an arm beside people, foreseen for the legs of a plan."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S, EnvConfig
from hrl_comfort.safety import kernels
from hrl_comfort.safety.geometry import ArmGeometry, turns
from hrl_comfort.safety.shield import LAGS, SERVO_SHARE
from hrl_comfort.scene.ratings import RATINGS
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.tasks import State

Array = NDArray[np.float64]
TRIED = np.array([1.0, 0.8, 0.6, 0.45, 0.3, 0.2])
"""Parts of the speed of a leg that are tried; beside people who are nearer, it is driven at the safe speed."""
SLOWEST = 0.05
"""Least part of the speed of a leg."""
FORESEEN_STEPS = 12.0
"""Control steps for which people go on as they walk; then they count as standing there. Many turn before long."""
WAITING, BODIES = 5, 6
"""Columns of the price of waiting, and of the first capsule, in the rows of people that the expert weighs."""
CAPSULE = 7
"""Numbers of a capsule in State.humans_body; its walk (2) m/s follows."""


def people_of(state: State) -> Array:
    """Return the capsules of people (N, Q * 9): ends, radius (`State.humans_body`), and velocity of the axis."""
    bodies, velocity = state.humans_body.numpy(), state.humans_vel.numpy()
    each = bodies.shape[1] // velocity.shape[1]
    walks = np.repeat(velocity, each, axis=1)
    return np.concatenate([bodies, walks], axis=2).reshape(len(bodies), -1)


class Beside:
    """Distances of the arm of `scene` from people, and the part of its speed that passes beside them."""

    def __init__(self, scene: Scene, config: EnvConfig) -> None:
        self._arm, self._safety = ArmGeometry(scene), config.safety
        self._shielded = config.safety.kind != "none"
        rating = RATINGS.get(config.robot.name, {}).get(config.robot.rating)
        self._acceleration = np.array(rating.acceleration_rad_s2) if rating else np.full(self._arm.joints, np.inf)

    def gaps(self, postures: Array, when: Array, people: Array) -> tuple[list[Array], Array]:
        """Return what `kernels.speeds` takes of the arm's pose, and distances (C, n) m of its capsules from people.

        `people` (Q * 9,) are as of `people_of`; the arm is in `postures` (n, J) rad in `when` (n,) control steps.
        """
        capsules = people.reshape(-1, CAPSULE + 2)
        ahead = np.minimum(when, FORESEEN_STEPS) * CONTROL_STEP_S
        ends = np.empty((3, len(capsules), 2, len(when)))
        ends[:] = capsules[:, :6].reshape(-1, 2, 3).transpose(2, 0, 1)[..., None]
        ends[:2] += (capsules[:, CAPSULE:].T[..., None] * ahead)[:, :, None]
        arm = self._arm
        *pose, apart = kernels.beside(
            *turns(postures), *arm.compiled, ends, arm.radius, np.ascontiguousarray(capsules[:, 6])
        )
        return pose, apart

    def passed(self, postures: Array, when: Array, velocity: Array, people: Array) -> Array:
        """Return the part (n,) of a `velocity` (n, J) rad/s that passes in `postures` (n, J) rad; see `gaps`.

        It is the largest of TRIED at which every capsule that is nearer to somebody than the way of both until it is
        slow, is slower than the safe speed; docs/safety.md has the terms.
        """
        if not self._shielded:
            return np.ones(len(postures))
        pose, apart = self.gaps(postures, when, people)
        speed = kernels.speeds(*pose, np.ascontiguousarray(velocity), self._arm.link, self._arm.radius)
        braking = (np.abs(velocity) / self._acceleration).max(axis=1)
        slow = SERVO_SHARE * self._safety.safe_speed_m_s
        walking = float(np.linalg.norm(people.reshape(-1, CAPSULE + 2)[:, CAPSULE:], axis=1).max())
        part = np.clip((slow / np.maximum(speed, 1e-9)).min(axis=0), SLOWEST, 1.0)
        for tried in TRIED[::-1]:
            fast = tried * speed
            brake_s = CONTROL_STEP_S + tried * braking * (1 - np.minimum(slow / np.maximum(fast, 1e-9), 1.0))
            way = fast * (self._safety.lag_s + self._safety.latency_s + (CONTROL_STEP_S + brake_s) / 2)
            settle_s = self._safety.latency_s + LAGS * self._safety.lag_s
            needed = way + self._reach(brake_s + settle_s, walking) + self._safety.margin_m
            safe = ((fast <= slow) | (needed < apart)).all(axis=0)
            part = np.where(safe, np.maximum(part, tried), part)
        return part

    def _reach(self, time_s: Array, speed_m_s: float) -> Array:
        """Return how far (...,) m the shield lets people get in (...,) s who walk at some speed."""
        safety, time = self._safety, time_s + self._safety.delay_s
        most = safety.human_speed_m_s
        speed = most if safety.bound == "worst" else min(speed_m_s, most)
        rising = np.minimum(time, (most - speed) / safety.human_acceleration_m_s2)
        top = speed + safety.human_acceleration_m_s2 * rising
        return (speed + top) / 2 * rising + top * (time - rising)


def of_rows(function: Callable[..., Array], person: Array, postures: Array, when: Array, *more: Array) -> Array:
    """Return `function` of `postures` (..., 6), `when` (...,) and `more` (..., 6) beside people.

    They are `person` (D,), as the expert weighs them, or (N, 1, D) where each of N rows has its own.
    """
    if person.ndim > 1:
        each = zip(person[:, 0], postures, np.broadcast_to(when, postures.shape[:-1]), *more, strict=True)
        return np.stack([of_rows(function, *row) for row in each])
    shape = postures.shape[:-1]
    flat = [np.ascontiguousarray(each.reshape(-1, each.shape[-1])) for each in (postures, *more)]
    return function(flat[0], np.broadcast_to(when, shape).ravel(), *flat[1:], person[BODIES:]).reshape(shape)
