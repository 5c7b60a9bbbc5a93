"""A control step of the drive and its shield as one kernel; see `hrl_comfort.compiled`.

`Drive.step`, `Shield.step` and the functions of `rating` define what it does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import kernel
from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.safety.kernels import Geometry, apart_of, farthest, posed, speeds
from hrl_comfort.safety.rating import ROUNDING
from hrl_comfort.scene.servos import SERVO_LAG_S

Array = NDArray[np.float64]


SHARES = np.linspace(0.0, 1.0, 9)[1:-1]
"""Shares that are tried where all is not safe; nothing else than the brake is share 0."""


class Limits(NamedTuple):
    """Other constants of a drive and its shield: see `Drive`, `Shield` and `SafetyConfig`.

    `human_acceleration` is infinite where the bound does not depend on the measured speed; truths are 0 and 1.
    """

    tool_speed: float
    late_s: float
    takes_back: float
    shielded: float
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
def sweep(velocity: Array, m: int, swept: Array) -> None:
    """Fill in what `bend` takes of row `m`, `swept` (J,)."""
    total = 0.0
    for j in range(velocity.shape[1]):
        rate = abs(velocity[m, j])
        swept[j] = rate * (rate + 2 * total)
        total += rate


@kernel
def bend(swept: Array, lever: Array, part: int) -> float:
    """See `ArmGeometry.bending`: of one capsule, with its `lever` (C, J)."""
    found = 0.0
    for j in range(len(swept)):
        found += lever[part, j] * swept[j]
    return found


@kernel
def bends(velocity: Array, lever: Array) -> Array:
    """See `ArmGeometry.bending`: of all rows and capsules (C, N)."""
    (n, joints), found = velocity.shape, np.zeros((len(lever), len(velocity)))
    rows, swept = np.empty((joints, n)), np.empty(joints)
    for m in range(n):
        sweep(velocity, m, swept)
        for j in range(joints):
            rows[j, m] = swept[j]
    for part in range(len(lever)):
        for j in range(joints):
            for m in range(n):
                found[part, m] += lever[part, j] * rows[j, m]
    return found


@kernel
def stopping_time(velocity: Array, m: int, acceleration: Array) -> float:
    """See `Rating.stopping_time`: of row `m`."""
    slowest = 0.0
    for j in range(velocity.shape[1]):
        slowest = max(abs(velocity[m, j]) / acceleration[j], slowest)
    return slowest


@kernel
def kept_within(asked: Array, m: int, low: Array, high: Array, angles: Array, acceleration: Array) -> float:
    """See `Rating.within`: return the share of `asked` (N, J) rad/s that row `m` may keep."""
    least = 1.0
    for j in range(asked.shape[1]):
        rate, half = abs(asked[m, j]), acceleration[j] * CONTROL_STEP_S / 2
        room = high[j] - angles[m, j] if asked[m, j] > 0 else angles[m, j] - low[j]
        fastest = np.sqrt(max(half * half + 2 * acceleration[j] * room, 0.0)) - half
        if rate > fastest:
            least = min(max(fastest / max(rate, ROUNDING), 0.0), least)
    return least


@kernel
def keeps(low: Array, high: Array, angles: Array, velocity: Array, m: int, acceleration: Array) -> bool:
    """See `Rating.keeps`: of row `m`."""
    steps = max(stopping_time(velocity, m, acceleration) / CONTROL_STEP_S, ROUNDING)
    whole = np.floor(steps)
    time = CONTROL_STEP_S * (1 + whole * (2 * steps - whole - 1) / (2 * steps))
    for j in range(velocity.shape[1]):
        end = angles[m, j] + velocity[m, j] * time
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
def unsafe(
    speed: float, bending: float, braking: float, room: float, moving: float, pace: float, limits: Limits
) -> bool:
    """Return whether `Shield._safe` does not hold of a capsule; `braking` s is how long its arm brakes."""
    fastest = speed + bending * (CONTROL_STEP_S + braking / 2)
    left = min(limits.servo_speed / max(fastest, 1e-9), 1.0)
    until = 0.0 if left >= 1.0 else CONTROL_STEP_S + braking * (1 - left) + limits.settled_s  # NaN stays
    travel = fastest * (CONTROL_STEP_S + braking * (1 - left * left) / 2)
    until = max(until, limits.settled_s if moving > limits.safe_speed else 0.0)
    return (until != 0.0) & (not room > travel + bound(until, pace, limits) + limits.margin_m)


@kernel
def first_unsafe(
    velocity: Array, slow: Array, fast: Array, share: float, room: Array, moving: Array, m: int, pace: float,
    lever: Array, acceleration: Array, limits: Limits, first: int, swept: Array,
) -> int:  # fmt: skip
    """Return a capsule of the arm of cell `m` that is unsafe, -1 if none is; look at the `first` before others.

    The arm runs `velocity` (1, J); its capsules move at `share` of the way from `slow` to `fast` (C, N) m/s. `swept`
    (J,) is for its own use.
    """
    braking, parts = stopping_time(velocity, 0, acceleration), len(slow)
    sweep(velocity, 0, swept)
    for index in range(parts):
        part = first + index if first + index < parts else first + index - parts
        speed = slow[part, m] + share * (fast[part, m] - slow[part, m])
        if unsafe(speed, bend(swept, lever, part), braking, room[part, m], moving[part, m], pace, limits):
            return part
    return -1


@kernel
def presses(
    begin: Array, wanted: Array, m: int, person: Array, geometry: Geometry, radius: Array, person_radius: Array
) -> bool:
    """See `Drive._yielding`: whether row `m`, which touches the person, would press on."""
    there, beside = np.empty((2, begin.shape[1])), np.empty((3, person.shape[1], 2, 2))
    for index in range(2):
        for j in range(begin.shape[1]):
            there[index, j] = begin[m, j] + index * wanted[m, j] * CONTROL_STEP_S
        for axis in range(3):
            for part in range(person.shape[1]):
                for end in range(2):
                    beside[axis, part, end, index] = person[axis, part, end, m]
    ends, here, ahead = posed(there, geometry)[2], np.inf, np.inf
    for part in range(len(radius)):
        here = min(apart_of(ends, part, beside, 0, radius, person_radius), here)
        ahead = min(apart_of(ends, part, beside, 1, radius, person_radius), ahead)
    return ahead < here


@kernel
def ramp(before: Array, after: Array, substeps: int) -> Array:
    """See `SetPoints.ramp`."""
    targets = np.empty((len(before), substeps, before.shape[1]))
    for m in range(len(before)):
        for step in range(substeps):
            share = (step + 1) / substeps
            for j in range(before.shape[1]):
                targets[m, step, j] = before[m, j] + share * (after[m, j] - before[m, j])
    return targets


@kernel
def drive(
    angles: Array, velocity: Array, share_sum: Array, braking: NDArray[np.bool_], stops: NDArray[np.int64],
    asked: Array, joints: Array, axis: Array, anchor: Array, ends: Array, person: Array, apart: Array,
    person_seen: Array, apart_seen: Array, seen: Array, trail: Array, steps: Array, offset: Array, axes: Array,
    anchors: Array, link: NDArray[np.int64], local: Array, radius: Array, lever: Array, person_radius: Array,
    rated: Array, limited_to: Array,
) -> tuple[Array, Array, Array, Array, Array, NDArray[np.bool_], NDArray[np.int64], Array]:  # fmt: skip
    """See `Drive.step`: of set-points, asked velocities and measured joints (N, ...), the arms beside the people.

    `person_seen` and `apart_seen` are what the shield sees of them, `seen` and `trail` its memory; then come constants
    of arm and person, `rated` (5, J) speeds, accelerations, range and following errors, and the fields of `Limits`.
    Return where the set-points begin, their fields at the end but for `human_beyond_bound`, and the trail.
    """
    geometry = (steps, offset, axes, anchors, link, local)
    speed_rad_s, acceleration, low, high, following = rated[0], rated[1], rated[2], rated[3], rated[4]
    limits = Limits(
        limited_to[0], limited_to[1], limited_to[2], limited_to[3], limited_to[4], limited_to[5], limited_to[6],
        limited_to[7], limited_to[8], limited_to[9], limited_to[10], limited_to[11], limited_to[12],
    )  # fmt: skip
    shielded = limits.shielded > 0.0
    n, count, parts = len(angles), angles.shape[1], len(radius)
    error, drawn = np.empty((n, count)), np.empty((n, count))
    for m in range(n):
        for j in range(count):
            error[m, j] = off = angles[m, j] - joints[m, j]
            late = joints[m, count + j] * limits.late_s
            more = off - min(max(off, min(late, 0.0)), max(late, 0.0))
            drawn[m, j] = joints[m, count + j] + more / SERVO_LAG_S
    way = speeds(axis, anchor, ends, error, link, radius)
    moving = speeds(axis, anchor, ends, drawn, link, radius)
    pace = farthest(person_seen, seen) / CONTROL_STEP_S
    held, begin, before = np.zeros(n, dtype=np.bool_), angles.copy(), velocity.copy()
    bent, swept, gets = bends(error, lever), np.empty(count), np.empty(n)
    for m in range(n):
        gets[m] = bound(limits.settled_s, pace[m], limits) + limits.margin_m
    for part in range(parts):
        for m in range(n):
            way[part, m] += bent[part, m] / 2
            near = not apart_seen[part, m] > way[part, m] + gets[m]
            held[m] |= shielded & (moving[part, m] > limits.safe_speed) & near
    for m in range(n):
        for j in range(count):
            held[m] |= abs(error[m, j]) / following[j] > 1.0
        if held[m] and limits.takes_back > 0.0:
            for j in range(count):
                begin[m, j], before[m, j] = min(max(joints[m, j], low[j]), high[j]), 0.0

    axis, anchor, ends = posed(begin, geometry)
    limited = np.empty((n, count))
    for m in range(n):
        over = 1.0
        for j in range(count):
            over = max(abs(asked[m, j]) / speed_rad_s[j], over)
        for j in range(count):
            limited[m, j] = asked[m, j] / over
    fastest = speeds(axis, anchor, ends, limited, link, radius)
    bent, brake, wanted = bends(limited, lever), np.empty((n, count)), np.empty((n, count))
    for m in range(n):
        most, most_bending = 0.0, 0.0
        for part in range(parts):
            most, most_bending = max(fastest[part, m], most), max(bent[part, m], most_bending)
        over = max((most + most_bending * CONTROL_STEP_S) / limits.tool_speed, 1.0)
        for j in range(count):
            limited[m, j] /= over
        kept = kept_within(limited, m, low, high, begin, acceleration)
        for j in range(count):
            limited[m, j] *= kept
            wanted[m, j] = limited[m, j] - before[m, j]
        needed = max(stopping_time(wanted, m, acceleration) / CONTROL_STEP_S, 1.0)
        left = 1 - CONTROL_STEP_S / max(stopping_time(before, m, acceleration), CONTROL_STEP_S)
        for j in range(count):
            wanted[m, j] = before[m, j] + wanted[m, j] / needed
            brake[m, j] = before[m, j] * left

    after, stopped = trail.copy(), held.copy()
    if shielded:
        slow = speeds(axis, anchor, ends, brake, link, radius)
        fast = speeds(axis, anchor, ends, wanted, link, radius)
        sent, room = trail.shape[1], apart_seen.copy()
        for part in range(parts):
            for index in range(sent):
                for m in range(n):
                    left = trail[part, index, m]
                    way[part, m] = max(way[part, m], left * limits.behind_s)  # NaN stays
                    if index:
                        moving[part, m] = max(moving[part, m], left)
            for m in range(n):
                room[part, m] -= way[part, m]
        bent, braked, worst = bends(wanted, lever), np.empty(n), np.full(n, -1)
        for m in range(n):
            braked[m] = stopping_time(wanted, m, acceleration)
        for part in range(parts):
            for m in range(n):
                fails = unsafe(
                    fast[part, m], bent[part, m], braked[m], room[part, m], moving[part, m], pace[m], limits
                )  # fmt: skip
                worst[m] = part if fails else worst[m]
        tried, passed = np.empty((1, count)), np.ones(n)
        for m in range(n):
            if worst[m] < 0:
                continue
            first, passed[m] = worst[m], 0.0
            for share in SHARES[::-1]:
                for j in range(count):
                    tried[0, j] = brake[m, j] + share * (wanted[m, j] - brake[m, j])
                first = first_unsafe(
                    tried, slow, fast, share, room, moving, m, pace[m], lever, acceleration, limits, first, swept
                )  # fmt: skip
                if first < 0:
                    passed[m] = share
                    break
            stopped[m] |= passed[m] == 0.0
        for m in range(n):
            for j in range(count):
                wanted[m, j] = brake[m, j] + passed[m] * (wanted[m, j] - brake[m, j])
        for part in range(parts):
            for m in range(n):
                newest = slow[part, m] + passed[m] * (fast[part, m] - slow[part, m])
                following = trail[part, 1, m] if sent > 1 else newest
                after[part, 0, m] = max(trail[part, 0, m] * limits.trailing, following)
                for index in range(1, sent):
                    after[part, index, m] = trail[part, index + 1, m] if index + 1 < sent else newest

    there, shares, sums, counts = np.empty((n, count)), np.ones(n), share_sum.copy(), stops.copy()
    for m in range(n):
        touches = False
        for part in range(parts):
            touches |= apart[part, m] <= 0.0
        brakes = held[m] or (touches and presses(begin, wanted, m, person, geometry, radius, person_radius))
        if brakes or not keeps(low, high, begin, wanted, m, acceleration):
            for j in range(count):
                wanted[m, j] = brake[m, j]
        speed, most = 0.0, 0.0
        for j in range(count):
            speed, most = speed + wanted[m, j] * wanted[m, j], most + limited[m, j] * limited[m, j]
            there[m, j] = min(max(begin[m, j] + wanted[m, j] * CONTROL_STEP_S, low[j]), high[j])
        if most > 0:
            shares[m] = min(np.sqrt(speed) / max(np.sqrt(most), 1e-9), 1.0)
        sums[m] += shares[m]
        counts[m] += stopped[m] and not braking[m]
    return begin, there, wanted, shares, sums, stopped, counts, after
