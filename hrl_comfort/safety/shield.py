"""Speed and separation monitoring between any policy and the arm, for N cells at once.

In each control step the shield passes the largest share of the commanded change of velocity for which the arm,
braking within its rating afterwards, either is slower than `safe_speed_m_s` or stands still before the person could
reach it. Share 0 is the brake: it continues the plan that was verified one control step earlier, so it is always
safe. docs/safety.md has the proof, ISO/TS 15066 section 5.5.4 the method.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.config import CONTROL_STEP_S, SafetyConfig
from hrl_comfort.safety.geometry import norm
from hrl_comfort.safety.rating import Rating
from hrl_comfort.safety.separation import Encounter, Separation

Array = NDArray[np.float64]
SHARES = np.linspace(0.0, 1.0, 9)[1:-1]
"""Shares that are tried where all is not safe; nothing else than the brake is share 0."""
LAGS = 3.0
"""Lags until the arm's speed has followed its set-points."""
SERVO_SHARE = 0.7
"""Part of the safe speed that set-points may use: the servos swing around them while they brake."""


class PersonBound:
    """How far any part of the person can get in a time, from what the sensors said up to now."""

    def __init__(self, config: SafetyConfig) -> None:
        self._config = config

    def distance(self, time_s: Array, speed: Array) -> Array:
        """Return the distance (...,) m within `time_s` (...,) s from now, for measured speeds (...,) m/s.

        `worst`: `human_speed_m_s` in any direction at any time. `observed`: the measured speed grows by at most
        `human_acceleration_m_s2` and to at most `human_speed_m_s`. Both start at the last measurement.
        """
        config = self._config
        time = time_s + config.delay_s
        if config.bound == "worst":
            return config.human_speed_m_s * time
        speed = np.minimum(speed, config.human_speed_m_s)
        rising = np.minimum(time, (config.human_speed_m_s - speed) / config.human_acceleration_m_s2)
        top = speed + config.human_acceleration_m_s2 * rising
        return np.asarray((speed + top) / 2 * rising + top * (time - rising))


class Shield:
    """The shield of N cells. Call `begin` for the rows whose episodes begin, then `step` once a control step."""

    def __init__(self, separation: Separation, rating: Rating, config: SafetyConfig, rows: int) -> None:
        self.arm, self._person = separation.arm, separation.person
        self._rating, self._config = rating, config
        self._bound = PersonBound(config)
        self._late_s = config.latency_s + config.lag_s
        self._trailing = np.exp(-CONTROL_STEP_S / self._late_s)
        """Share of a speed that the arm still has after a control step."""
        parts = len(self._person.radius)
        self._seen = np.zeros((3, parts, 2, rows))
        """Ends of the person's capsules at the control step before."""
        self._trail = np.zeros((len(self.arm.radius), rows))
        """Speed of each capsule of which the arm may still be behind, m/s."""
        self._decision: list[tuple[Array, Array]] = []
        """Both after each control step of a decision."""

    def begin(self, rows: NDArray[np.int64], limbs: Array) -> None:
        """Forget the motion of `rows` (r,), whose people stand at `limbs` (r, L, 7)."""
        self._seen[..., rows] = self._person.ends(limbs)
        self._trail[:, rows] = 0.0

    def begin_decision(self) -> None:
        """Begin a decision, of which some control steps may turn out void."""
        self._decision = []

    def end_decision(self, last: NDArray[np.int64]) -> None:
        """Go back to the last valid control step (N,) of the decision in each row, counted from 0."""
        rows = np.arange(len(last))
        self._seen, self._trail = (
            np.stack(each)[last, ..., rows].transpose(*range(1, each[0].ndim), 0)
            for each in zip(*self._decision, strict=True)
        )

    def state_dict(self) -> dict[str, Tensor]:
        """Return what an exact continuation needs."""
        return {"seen": torch.from_numpy(self._seen.copy()), "trail": torch.from_numpy(self._trail.copy())}

    def load_state_dict(self, saved: dict[str, Tensor]) -> None:
        """Continue from `state_dict`."""
        self._seen, self._trail = saved["seen"].numpy().copy(), saved["trail"].numpy().copy()

    def step(self, now: Encounter, before: Array, wanted: Array) -> tuple[Array, Array]:
        """Return the velocity (N, J) rad/s that may be run in this control step, and the share (N,) passed.

        `now` are the arms at their set-points and the people, `before` (N, J) rad/s the velocity of the set-points,
        `wanted` (N, J) what the rating would pass.
        """
        pace = self._pace(now)
        self._seen = now.person

        brake = self._rating.brake(before)
        slow, fast = self.arm.speeds(now.pose, brake), self.arm.speeds(now.pose, wanted)
        share = self._safe(wanted, fast, now.apart, self._trail, pace).astype(float)
        rows = np.flatnonzero(share == 0.0)
        if len(rows):
            # All shares of all such rows at once, those of a share together.
            tried, at = np.repeat(SHARES, len(rows)), np.tile(rows, len(SHARES))
            velocity = brake[at] + tried[:, None] * (wanted[at] - brake[at])
            speeds = slow[:, at] + tried * (fast[:, at] - slow[:, at])  # convex in it, so not below the true ones
            safe = self._safe(velocity, speeds, now.apart[:, at], self._trail[:, at], pace[at])
            share[rows] = np.where(safe, tried, 0.0).reshape(len(SHARES), -1).max(axis=0)
        velocity = brake + share[:, None] * (wanted - brake)
        self._trail = np.maximum(slow + share * (fast - slow), self._trail * self._trailing)
        self._decision.append((self._seen, self._trail))
        return velocity, share

    def reach(self, now: Encounter, velocity: Array) -> Array:
        """Return how far (N,) m any part of the person may get until arms at `velocity` (N, J) rad/s are slow.

        They run on for a control step and brake then; 0 beside an arm that is slow already. Nothing depends on it.
        """
        until = self._plan(velocity, self.arm.speeds(now.pose, velocity))[0].max(axis=0)
        return np.where(until > 0.0, self._bound.distance(until, self._pace(now)), 0.0)

    def _pace(self, now: Encounter) -> Array:
        """Return the speed (N,) m/s of the person's fastest part since the control step before."""
        return np.asarray(norm(now.person - self._seen).max(axis=(0, 1)) / CONTROL_STEP_S)

    def _plan(self, velocity: Array, speeds: Array) -> tuple[Array, Array, Array]:
        """Return when (C, N) s the capsules of braking arms are slow, their way (C, N) m and top speed (C, N) m/s.

        Arguments are those of `_safe`.
        """
        braking = self._rating.stopping_time(velocity)
        fastest = speeds + self.arm.bending(velocity) * (CONTROL_STEP_S + braking / 2)
        # Until the capsule is slower than the safe speed, servo lag included, the person must not reach it.
        left = np.minimum(SERVO_SHARE * self._config.safe_speed_m_s / np.maximum(fastest, 1e-9), 1.0)
        late = self._config.latency_s + LAGS * self._config.lag_s
        until = np.where(left < 1.0, CONTROL_STEP_S + braking * (1 - left) + late, 0.0)
        return until, fastest * (CONTROL_STEP_S + braking * (1 - left * left) / 2), fastest

    def _safe(self, velocity: Array, speeds: Array, apart: Array, trail: Array, pace: Array) -> NDArray[np.bool_]:
        """Return (N,) whether running `velocity` (N, J) for a control step and braking then is safe.

        `speeds` (C, N) m/s are those of the arm's capsules now, `apart` (C, N) m their distances from the
        person, `trail` (C, N) m/s speeds that they may still have, `pace` (N,) m/s that of the person's fastest part.
        """
        until, travel, fastest = self._plan(velocity, speeds)
        behind = np.maximum(trail, fastest) * self._late_s
        reach = self._bound.distance(until, pace)
        clear = (until == 0.0) | (apart > travel + behind + reach + self._config.margin_m)
        return np.asarray(clear.all(axis=0))
