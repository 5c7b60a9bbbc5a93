"""A control step of the drive and its shield as one kernel; see `hrl_comfort.compiled`.

`Drive.step`, `Shield.step` and the functions of `rating` define what it does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import kernel
from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.safety.kernels import Geometry, farthest, gaps, posed, speeds
from hrl_comfort.safety.rating import ROUNDING
from hrl_comfort.scene.servos import SERVO_LAG_S

Array = NDArray[np.float64]


class Arm(NamedTuple):
    """What is constant of an arm: see `ArmGeometry`, `Rating` and `Drive`."""

    geometry: Geometry
    link: NDArray[np.int64]
    radius: Array
    lever: Array
    speed_rad_s: Array
    acceleration_rad_s2: Array
    tool_speed_m_s: float
    low: Array
    high: Array
    following_rad: Array
    late_s: float
    takes_back: bool
    person_radius: Array


class Limits(NamedTuple):
    """What is constant of a shield: see `Shield` and `SafetyConfig`.

    `human_acceleration` is infinite where the bound does not depend on the measured speed.
    """

    shares: Array
    settled_s: float
    behind_s: float
    trailing: float
    servo_speed: float
    safe_speed: float
    delay_s: float
    margin_m: float
    human_speed: float
    human_acceleration: float


@kernel
def bend(velocity: Array, lever: Array, bound: Array) -> None:
    """See `ArmGeometry.bending`: of one arm's `velocity` (J,), into `bound` (C,)."""
    total = 0.0
    bound[:] = 0.0
    for j in range(len(velocity)):
        rate = abs(velocity[j])
        swept = rate * (rate + 2 * total)
        total += rate
        for part in range(len(bound)):
            bound[part] += lever[part, j] * swept


@kernel
def stopping_time(velocity: Array, acceleration: Array) -> float:
    """See `Rating.stopping_time`."""
    slowest = 0.0
    for j in range(len(velocity)):
        slowest = max(abs(velocity[j]) / acceleration[j], slowest)
    return slowest


@kernel
def limit(asked: Array, low: Array, high: Array, angles: Array, acceleration: Array) -> None:
    """See `Rating.within`; change `asked` (J,)."""
    least = 1.0
    for j in range(len(asked)):
        rate, half = abs(asked[j]), acceleration[j] * CONTROL_STEP_S / 2
        room = high[j] - angles[j] if asked[j] > 0 else angles[j] - low[j]
        fastest = np.sqrt(max(half * half + 2 * acceleration[j] * room, 0.0)) - half
        if rate > fastest:
            least = min(max(fastest / max(rate, ROUNDING), 0.0), least)
    for j in range(len(asked)):
        asked[j] *= least


@kernel
def keeps(low: Array, high: Array, angles: Array, velocity: Array, acceleration: Array) -> bool:
    """See `Rating.keeps`."""
    steps = max(stopping_time(velocity, acceleration) / CONTROL_STEP_S, ROUNDING)
    whole = np.floor(steps)
    time = CONTROL_STEP_S * (1 + whole * (2 * steps - whole - 1) / (2 * steps))
    for j in range(len(velocity)):
        end = angles[j] + velocity[j] * time
        if not low[j] - ROUNDING < end < high[j] + ROUNDING:
            return False
    return True


@kernel
def bound(time_s: float, pace: float, limits: Limits) -> float:
    """See `Shield._bound`."""
    time = time_s + limits.delay_s
    if limits.human_acceleration == np.inf:
        return limits.human_speed * time
    speed = min(pace, limits.human_speed)
    rising = min(time, (limits.human_speed - speed) / limits.human_acceleration)
    top = speed + limits.human_acceleration * rising
    return (speed + top) / 2 * rising + top * (time - rising)


@kernel
def safe(
    velocity: Array, slow: Array, fast: Array, share: float, room: Array, moving: Array, m: int, pace: float, arm: Arm,
    limits: Limits, bending: Array,
) -> bool:  # fmt: skip
    """See `Shield._safe`: of row `m`, whose capsules move at `share` of the way from `slow` to `fast` (C, N) m/s."""
    braking = stopping_time(velocity, arm.acceleration_rad_s2)
    bend(velocity, arm.lever, bending)
    for part in range(len(bending)):
        speed = slow[part, m] + share * (fast[part, m] - slow[part, m]) if share < 1.0 else fast[part, m]
        fastest = speed + bending[part] * (CONTROL_STEP_S + braking / 2)
        left = min(limits.servo_speed / max(fastest, 1e-9), 1.0)
        until = CONTROL_STEP_S + braking * (1 - left) + limits.settled_s if left < 1.0 else 0.0
        travel = fastest * (CONTROL_STEP_S + braking * (1 - left * left) / 2)
        until = max(until, limits.settled_s if moving[part, m] > limits.safe_speed else 0.0)
        if until != 0.0 and not room[part, m] > travel + bound(until, pace, limits) + limits.margin_m:
            return False
    return True


@kernel
def presses(begin: Array, wanted: Array, person: Array, m: int, arm: Arm) -> bool:
    """See `Drive._yielding`: whether row `m`, which touches the person, would press on."""
    there, beside = np.empty((2, len(begin))), np.empty((*person.shape[:3], 2))
    for index in range(2):
        there[index] = begin + index * wanted * CONTROL_STEP_S
        beside[..., index] = person[..., m]
    apart = gaps(posed(there, arm.geometry)[2], beside, arm.radius, arm.person_radius)
    return apart[:, 1].min() < apart[:, 0].min()


@kernel
def drive(
    angles: Array, velocity: Array, share_sum: Array, braking: NDArray[np.bool_], stops: NDArray[np.int64],
    asked: Array, joints: Array, axis: Array, anchor: Array, ends: Array, person: Array, apart: Array, shielded: bool,
    person_seen: Array, apart_seen: Array, seen: Array, trail: Array, arm: Arm, limits: Limits,
) -> tuple[Array, Array, Array, Array, Array, NDArray[np.bool_], NDArray[np.int64], Array]:  # fmt: skip
    """See `Drive.step`: of set-points, asked velocities and measured joints (N, ...), the arms beside the people.

    `person_seen` and `apart_seen` are what the shield sees of them, `seen` and `trail` its memory. Return where the
    set-points begin, their fields at the end but for `human_beyond_bound`, and the trail.
    """
    n, count, parts = len(angles), angles.shape[1], len(arm.radius)
    error, drawn = np.empty((n, count)), np.empty((n, count))
    for m in range(n):
        for j in range(count):
            error[m, j] = off = angles[m, j] - joints[m, j]
            late = joints[m, count + j] * arm.late_s
            more = off - min(max(off, min(late, 0.0)), max(late, 0.0))
            drawn[m, j] = joints[m, count + j] + more / SERVO_LAG_S
    way = speeds(axis, anchor, ends, error, arm.link, arm.radius)
    moving = speeds(axis, anchor, ends, drawn, arm.link, arm.radius)
    pace, bending = farthest(person_seen, seen) / CONTROL_STEP_S, np.empty(parts)
    held, begin, before = np.zeros(n, dtype=np.bool_), angles.copy(), velocity.copy()
    for m in range(n):
        for j in range(count):
            held[m] |= abs(error[m, j]) / arm.following_rad[j] > 1.0
        bend(error[m], arm.lever, bending)
        for part in range(parts):
            way[part, m] += bending[part] / 2
        if shielded:
            gets = bound(limits.settled_s, pace[m], limits) + limits.margin_m
            for part in range(parts):
                held[m] |= moving[part, m] > limits.safe_speed and not apart_seen[part, m] > way[part, m] + gets
        if held[m] and arm.takes_back:
            for j in range(count):
                begin[m, j], before[m, j] = min(max(joints[m, j], arm.low[j]), arm.high[j]), 0.0

    axis, anchor, ends = posed(begin, arm.geometry)
    limited = np.empty((n, count))
    for m in range(n):
        over = 1.0
        for j in range(count):
            over = max(abs(asked[m, j]) / arm.speed_rad_s[j], over)
        limited[m] = asked[m] / over
    fastest = speeds(axis, anchor, ends, limited, arm.link, arm.radius)
    brake, wanted = np.empty((n, count)), np.empty((n, count))
    for m in range(n):
        bend(limited[m], arm.lever, bending)
        most = fastest[:, m].max() + bending.max() * CONTROL_STEP_S
        limited[m] /= max(most / arm.tool_speed_m_s, 1.0)
        limit(limited[m], arm.low, arm.high, begin[m], arm.acceleration_rad_s2)
        needed = stopping_time(limited[m] - before[m], arm.acceleration_rad_s2)
        wanted[m] = before[m] + (limited[m] - before[m]) / max(needed / CONTROL_STEP_S, 1.0)
        stopping = max(stopping_time(before[m], arm.acceleration_rad_s2), CONTROL_STEP_S)
        brake[m] = before[m] * (1 - CONTROL_STEP_S / stopping)

    after, stopped = trail.copy(), held.copy()
    if shielded:
        slow = speeds(axis, anchor, ends, brake, arm.link, arm.radius)
        fast = speeds(axis, anchor, ends, wanted, arm.link, arm.radius)
        sent, room = trail.shape[1], apart_seen.copy()
        for part in range(parts):
            for index in range(sent):
                for m in range(n):
                    left = trail[part, index, m]
                    way[part, m] = max(left * limits.behind_s, way[part, m])
                    if index:
                        moving[part, m] = max(left, moving[part, m])
            for m in range(n):
                room[part, m] -= way[part, m]
        tried = np.empty(count)
        for m in range(n):
            passed = 1.0
            if not safe(wanted[m], slow, fast, 1.0, room, moving, m, pace[m], arm, limits, bending):
                passed = 0.0
                for share in limits.shares[::-1]:
                    for j in range(count):
                        tried[j] = brake[m, j] + share * (wanted[m, j] - brake[m, j])
                    if safe(tried, slow, fast, share, room, moving, m, pace[m], arm, limits, bending):
                        passed = share
                        break
            stopped[m] |= passed == 0.0
            for j in range(count):
                wanted[m, j] = brake[m, j] + passed * (wanted[m, j] - brake[m, j])
            for part in range(parts):
                newest = slow[part, m] + passed * (fast[part, m] - slow[part, m])
                following = trail[part, 1, m] if sent > 1 else newest
                after[part, 0, m] = max(trail[part, 0, m] * limits.trailing, following)
                for index in range(1, sent):
                    after[part, index, m] = trail[part, index + 1, m] if index + 1 < sent else newest

    there, shares, sums, counts = np.empty((n, count)), np.ones(n), share_sum.copy(), stops.copy()
    for m in range(n):
        touches = apart[:, m].min() <= 0.0
        if touches and presses(begin[m], wanted[m], person, m, arm):
            wanted[m] = brake[m]
        if held[m] or not keeps(arm.low, arm.high, begin[m], wanted[m], arm.acceleration_rad_s2):
            wanted[m] = brake[m]
        speed, most = 0.0, 0.0
        for j in range(count):
            speed, most = speed + wanted[m, j] * wanted[m, j], most + limited[m, j] * limited[m, j]
            there[m, j] = min(max(begin[m, j] + wanted[m, j] * CONTROL_STEP_S, arm.low[j]), arm.high[j])
        if most > 0:
            shares[m] = min(np.sqrt(speed) / max(np.sqrt(most), 1e-9), 1.0)
        sums[m] += shares[m]
        counts[m] += stopped[m] and not braking[m]
    return begin, there, wanted, shares, sums, stopped, counts, after
