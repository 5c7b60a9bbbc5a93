"""Speed and separation monitoring between any policy and the arm, for N cells at once.

In each control step the shield passes the largest share of the commanded change of velocity for which the arm,
braking within its rating afterwards, either is slower than `safe_speed_m_s` or stands still before the person could
reach it. Share 0 is the brake: it continues the plan that was verified one control step earlier, so it is always
safe. docs/safety.md has the proof, ISO/TS 15066 section 5.5.4 the method.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.compiled import contiguous
from hrl_comfort.config import CONTROL_STEP_S, SafetyConfig
from hrl_comfort.instants import chosen, ended_early
from hrl_comfort.safety import kernels
from hrl_comfort.safety.drive_kernels import SHARES
from hrl_comfort.safety.geometry import ArmPose, farthest
from hrl_comfort.safety.rating import ROUNDING, Rating
from hrl_comfort.safety.rows import InRows, Rows, in_rows
from hrl_comfort.safety.separation import Encounter, Separation

Array = NDArray[np.float64]
LAGS = 3.0
"""Lags until the arm's speed has followed its set-points."""
SERVO_SHARE = 0.7
"""Part of the safe speed that set-points may use: the servos swing around them while they brake."""


@dataclass(frozen=True)
class Memory:
    """Memory of the shield of N cells from one control step to the next."""

    seen: Array
    """(3, P, 2, N) m, ends of the person's capsules at the control step before."""
    trail: Array
    """(C, 1 + W, N) m/s, speeds of each capsule's set-points that the arm may still be behind: what is left of those
    that the servos have had, and those of the last W control steps, which are on their way to them."""


@dataclass(frozen=True)
class Motion:
    """Motion that the servos of N arms may make of their distance from their set-points."""

    way: Array
    """(C, N) m, how far each capsule is from where the set-points have it, at most."""
    speed: Array
    """(C, N) m/s, of the fastest point of each capsule as the servos are about to move it."""


class Shield:
    """The shield of N cells. Call `begin` for the rows whose episodes begin, then `step` once a control step."""

    def __init__(
        self, separation: Separation, rating: Rating, config: SafetyConfig, rows: int, within: InRows = in_rows
    ) -> None:
        self.arm, self._person = separation.arm, separation.person
        self._rating, self._config, self._in_rows = rating, config, within
        self._behind_s = config.latency_s + config.lag_s
        self._settled_s = config.latency_s + LAGS * config.lag_s
        """Time until the arm's speed is that of set-points that it has been sent."""
        self._trailing = np.exp(-CONTROL_STEP_S / max(config.lag_s, 1e-9))
        """Share of a speed that the arm still has after a control step."""
        self._first = config.human_speed_m_s * CONTROL_STEP_S * np.array([0.0, 0.0, 1.0])[:, None, None, None]
        parts, sent = len(self._person.radius), int(np.ceil(config.latency_s / CONTROL_STEP_S - 1e-9))
        self.limits = (
            self._settled_s, self._behind_s, self._trailing, SERVO_SHARE * config.safe_speed_m_s, config.safe_speed_m_s,
            config.delay_s, config.margin_m, config.human_speed_m_s,
            np.inf if config.bound == "worst" else config.human_acceleration_m_s2,
        )  # fmt: skip
        """The last fields of `drive_kernels.Limits`."""
        self.memory = Memory(np.zeros((3, parts, 2, rows)), np.zeros((len(self.arm.radius), 1 + sent, rows)))
        self._decision: list[Memory] = []
        """The memory after each control step of a decision."""

    def begin(self, rows: NDArray[np.int64], limbs: Array) -> None:
        """Forget the motion of `rows` (r,), whose people at `limbs` (r, L, 7) may move at the largest speed."""
        self.memory.seen[..., rows] = self._person.ends(limbs) + self._first
        self.memory.trail[..., rows] = 0.0

    def begin_decision(self) -> None:
        """Begin a decision, of which some control steps may turn out void."""
        self._decision = []

    def end_decision(self, last: NDArray[np.int64]) -> None:
        """Go back to the last valid control step (N,) of the decision in each row, counted from 0."""
        if (last == last[0]).all():
            self.memory = self._decision[last[0]]
            return
        early = ended_early(last, len(self._decision))
        kept = ([getattr(memory, name) for memory in self._decision] for name in vars(self.memory))
        self.memory = Memory(*(chosen(each, early, rows_last=True) for each in kept))

    def state_dict(self) -> dict[str, Tensor]:
        """Return what an exact continuation needs, rows first."""
        return {name: torch.from_numpy(np.moveaxis(value, -1, 0).copy()) for name, value in vars(self.memory).items()}

    def load_state_dict(self, saved: dict[str, Tensor]) -> None:
        """Continue from `state_dict`."""
        kept = {name: np.moveaxis(value.numpy(), 0, -1) for name, value in saved.items()}
        self.memory = Memory(**{name: np.ascontiguousarray(value) for name, value in kept.items()})

    def swings(self, now: Encounter, motion: Motion) -> NDArray[np.bool_]:
        """Return (N,) whether the person may be reached while servos move the arm at more than the safe speed.

        No brake of the set-points hinders that: they must be taken back to the arm.
        """
        clear = now.apart > motion.way + self._bound(self._settled_s, self._pace(now)) + self._config.margin_m
        fast: NDArray[np.bool_] = motion.speed > self._config.safe_speed_m_s
        calm: NDArray[np.bool_] = np.logical_or(~fast, clear).all(axis=0)
        return ~calm

    def step(
        self, now: Encounter, motion: Motion, set_points: ArmPose, before: Array, wanted: Array
    ) -> tuple[Array, Array]:
        """Return the velocity (N, J) rad/s that may be run in this control step, and the share (N,) passed.

        `now` are the measured arms and the people, `set_points` the arms there, `before` (N, J) rad/s their velocity,
        `wanted` (N, J) what the rating would pass.
        """
        pace, trail = self._pace(now), self.memory.trail
        behind = np.maximum(motion.way, trail.max(axis=1) * self._behind_s)
        moving = np.maximum(motion.speed, trail[:, 1:].max(axis=1)) if trail.shape[1] > 1 else motion.speed
        room, brake = now.apart - behind, self._rating.brake(before)
        slow, fast = self.arm.speeds(set_points, brake), self.arm.speeds(set_points, wanted)

        def largest(rows: Rows) -> Array:
            """Return the largest of SHARES that is safe in `rows`, 0 if none is."""
            # All shares of all rows at once, those of a share together.
            start, change = (np.tile(each[rows], (len(SHARES), 1)) for each in (brake, wanted - brake))
            least, gained, free, real, speed = (
                np.tile(each[..., rows], len(SHARES)) for each in (slow, fast - slow, room, moving, pace)
            )
            tried = np.repeat(SHARES, len(start) // len(SHARES))
            # The speeds are convex in the share, so not below the true ones.
            safe = self._safe(start + tried[:, None] * change, least + tried * gained, free, real, speed)
            found: Array = np.where(safe, tried, 0.0).reshape(len(SHARES), -1).max(axis=0)
            return found

        safe = self._safe(wanted, fast, room, moving, pace)
        share = self._in_rows(~safe, largest, np.ones(len(wanted)))
        velocity = brake + share[:, None] * (wanted - brake)
        sent = np.concatenate([trail, (slow + share * (fast - slow))[:, None]], axis=1)
        left = np.maximum(sent[:, :1] * self._trailing, sent[:, 1:2])
        self.remember(now.person, np.concatenate([left, sent[:, 2:]], axis=1))
        return velocity, share

    def remember(self, seen: Array, trail: Array) -> None:
        """Keep the fields of `Memory` after a control step."""
        self.memory = Memory(seen, trail)
        self._decision.append(self.memory)

    def sent(self, speeds: Array) -> None:
        """Take note that capsules were commanded `speeds` (C, N) m/s after all in the latest control step."""
        trail = self.memory.trail
        newest = np.maximum(trail[:, -1], speeds)[:, None]
        self.memory = Memory(self.memory.seen, np.concatenate([trail[:, :-1], newest], axis=1))
        self._decision[-1] = self.memory

    def reach(self, now: Encounter, velocity: Array) -> Array:
        """Return how far (N,) m any part of the person may get until arms at `velocity` (N, J) rad/s are slow.

        They run on for a control step and brake then; 0 beside an arm that is slow already. Nothing depends on it.
        """
        until = self._plan(velocity, self.arm.speeds(now.pose, velocity))[0].max(axis=0)
        return np.where(until > 0.0, self._bound(until, self._pace(now)), 0.0)

    def beyond_bound(self, now: Encounter, after: Array, way: float) -> NDArray[np.bool_]:
        """Return (N,) whether people come nearer to a capsule of the arm than `human_speed_m_s` allows.

        Their capsules have their ends at `after` (3, P, 2, N) a control step after `now`; none went over `way` m.
        """
        most = self._config.human_speed_m_s * CONTROL_STEP_S + ROUNDING
        if not way > most:
            return np.zeros(after.shape[-1], dtype=bool)
        given = contiguous(now.pose.ends, now.apart, now.person, after)
        return kernels.approached(*given, self.arm.radius, self._person.radius, most)

    def _pace(self, now: Encounter) -> Array:
        """Return the speed (N,) m/s of the person's fastest part since the control step before."""
        return farthest(now.person, self.memory.seen) / CONTROL_STEP_S

    def _bound(self, time_s: Array | float, speed: Array) -> Any:
        """Return how far (...,) m any part of the person gets within `time_s` (...,) s, measured at `speed` (...,) m/s.

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
        return (speed + top) / 2 * rising + top * (time - rising)

    def _plan(self, velocity: Array, speeds: Array) -> tuple[Array, Array]:
        """Return when (C, N) s the capsules of braking arms are slow, and their way (C, N) m until then.

        Arguments are those of `_safe`.
        """
        braking = self._rating.stopping_time(velocity)
        fastest = speeds + self.arm.bending(velocity) * (CONTROL_STEP_S + braking / 2)
        # Until the capsule is slower than the safe speed, servo lag included, the person must not reach it.
        left = np.minimum(SERVO_SHARE * self._config.safe_speed_m_s / np.maximum(fastest, 1e-9), 1.0)
        until = np.where(left < 1.0, CONTROL_STEP_S + braking * (1 - left) + self._settled_s, 0.0)
        return until, fastest * (CONTROL_STEP_S + braking * (1 - left * left) / 2)

    def _safe(self, velocity: Array, speeds: Array, room: Array, moving: Array, pace: Array) -> NDArray[np.bool_]:
        """Return (N,) whether running `velocity` (N, J) for a control step and braking then is safe.

        `speeds` (C, N) m/s are those of the capsules' set-points, `room` (C, N) m how far at least each of them stays
        from the person until the arm is at its set-points, `moving` (C, N) m/s speeds that the arm has or will have
        before, `pace` (N,) m/s that of the person's fastest part.
        """
        until, travel = self._plan(velocity, speeds)
        until = np.maximum(until, np.where(moving > self._config.safe_speed_m_s, self._settled_s, 0.0))
        clear = np.logical_or(until == 0.0, room > travel + self._bound(until, pace) + self._config.margin_m)
        safe: NDArray[np.bool_] = clear.all(axis=0)
        return safe
