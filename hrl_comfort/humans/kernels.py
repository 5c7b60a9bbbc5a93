"""Compiled twins of the functions with which people move; see `hrl_comfort.compiled`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import kernel
from hrl_comfort.config import CONTROL_STEP_S

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


TURN_RAD_S, TURN_RAD_S2 = 1.6, 3.0
"""Largest turning rate and its largest change: a right angle takes 1.5 s, as in turns while standing (Hase and Stein,
Journal of Neurophysiology 81, 1999)."""
CLEARANCE_M, LEAVE_S = 0.03, 0.5
"""Distance kept from the rim of a disc, and time in which people leave that margin."""
WAIT_STEPS = 50
"""Control steps at the end of a retreat in which people stand."""
FREE, BOUND, RETREAT_SPEED, RETREAT_ACCELERATION = range(4)
"""Limits of a motion: whether bound and discs do not apply, its bound, and speed and acceleration of a retreat, whose
speed is 0 for those who stay."""


@kernel
def beside(
    x: float, y: float, wx: float, wy: float, discs: Array, disc: int, radius_m: float, acceleration_m_s2: float
) -> tuple[float, float, float, float]:
    """Return the speeds at which somebody wants to approach a disc and may, m/s, and the direction away from it."""
    dx, dy = x - discs[disc, 0], y - discs[disc, 1]
    distance = max(math.sqrt(dx * dx + dy * dy), 1e-9)
    ax, ay = dx / distance, dy / distance
    gap = distance - radius_m - CLEARANCE_M
    allowed = math.sqrt(2 * acceleration_m_s2 * max(gap, 0.0)) + min(gap, 0.0) / LEAVE_S
    return -(wx * ax + wy * ay), allowed, ax, ay


@kernel
def stepped(
    x: float, y: float, vx: float, vy: float, wx: float, wy: float, discs: Array, radius_m: float, speed_m_s: float,
    acceleration_m_s2: float,
) -> tuple[float, float]:  # fmt: skip
    """See `steering.step`: of somebody at (x, y) m, with velocity (vx, vy) m/s, who wants (wx, wy) m/s."""
    turns = False
    for disc in range(len(discs)):
        inwards, allowed, _, _ = beside(x, y, wx, wy, discs, disc, radius_m, acceleration_m_s2 / 4)
        turns |= inwards > allowed
    if turns:
        for disc in range(len(discs)):
            inwards, allowed, ax, ay = beside(x, y, wx, wy, discs, disc, radius_m, acceleration_m_s2 / 4)
            excess = max(inwards - allowed, 0.0)
            way = -1.0 if wx * -ay + wy * ax < 0 else 1.0
            aside = (excess if inwards > 0 else 0.0) * way
            wx, wy = wx + excess * ax + aside * -ay, wy + excess * ay + aside * ax
    share = min(1.0, speed_m_s / max(math.sqrt(wx * wx + wy * wy), 1e-9))
    cx, cy = wx * share - vx, wy * share - vy
    share = min(1.0, acceleration_m_s2 * CONTROL_STEP_S / max(math.sqrt(cx * cx + cy * cy), 1e-9))
    return x + (vx + cx * share) * CONTROL_STEP_S, y + (vy + cy * share) * CONTROL_STEP_S


@kernel
def step(
    position: Array, velocity: Array, wanted: Array, discs: Array, radius_m: float, speed_m_s: float,
    acceleration_m_s2: float,
) -> Array:  # fmt: skip
    """See `steering.step`: beside `discs` (n, g, 2)."""
    there = np.empty((len(wanted), 2))
    for m in range(len(wanted)):
        there[m, 0], there[m, 1] = stepped(
            position[m, 0], position[m, 1], velocity[m, 0], velocity[m, 1], wanted[m, 0], wanted[m, 1], discs[m],
            radius_m, speed_m_s, acceleration_m_s2,
        )  # fmt: skip
    return there


@kernel
def turned(yaw: float, rate: float, wanted: float) -> float:
    """Return the yaw, rad, after a control step of turning to `wanted` rad the shorter way round, from `rate` rad/s."""
    brake = TURN_RAD_S2 * CONTROL_STEP_S
    left = (wanted - yaw + math.pi) % (2 * math.pi) - math.pi
    size = min(TURN_RAD_S, math.sqrt(brake * brake + 2 * TURN_RAD_S2 * abs(left)) - brake)
    asked = (size if left > 0 else -size if left < 0 else 0.0) - rate
    return yaw + (rate + min(max(asked, -brake), brake)) * CONTROL_STEP_S


@kernel
def held(
    x: float, y: float, before: Array, spawn: Array, discs: Array, radius_m: float, bound_m: float
) -> tuple[float, float]:
    """Return the proposed place (x, y) m as `humans.advance` bounds it."""
    dx, dy = x - spawn[0], y - spawn[1]
    shrink = min(1.0, bound_m / max(math.sqrt(dx * dx + dy * dy), 1e-9))
    x, y = spawn[0] + dx * shrink, spawn[1] + dy * shrink
    cx, cy, least = 0.0, 0.0, np.inf
    for disc in range(len(discs)):
        dx, dy = x - discs[disc, 0], y - discs[disc, 1]
        distance = math.sqrt(dx * dx + dy * dy)
        if distance < least:
            cx, cy, least = discs[disc, 0], discs[disc, 1], distance
    if least >= radius_m:
        return x, y
    span = max(least, 1e-9)
    x, y = cx + (x - cx) / span * (radius_m + 1e-9), cy + (y - cy) / span * (radius_m + 1e-9)
    dx, dy = x - spawn[0], y - spawn[1]
    stays = math.sqrt(dx * dx + dy * dy) > bound_m + 1e-9
    for disc in range(len(discs)):
        dx, dy = x - discs[disc, 0], y - discs[disc, 1]
        stays |= math.sqrt(dx * dx + dy * dy) < radius_m
    return (before[0], before[1]) if stays else (x, y)


@kernel
def settle(
    there: Array, facing: Array, bent: Array, kept: Array, limits: Array, position: Array, yaw: Array, spawn: Array,
    walked_m: Array, speed_m_s: Array, steps: Ints, velocity: Array, limbs: Array, memory: Array, traits: Array,
    retreat: Ints, discs: Array, radius_m: float, arm: Array, smoothing: float,
) -> tuple[Array, Array, Array, Ints, Ints]:  # fmt: skip
    """Hold people to what they may do: change the proposed places `there`, yaws `facing`, limbs `bent`, memory `kept`.

    Return velocity, distance walked, smoothed speed, control steps, and those left of a retreat. `limits` are those of
    the motions that the people draw from. Who retreats goes away from the nearest point of the `arm` (n, P, 3) m,
    within the bounds of the motion on speed and acceleration, and keeps to the discs. Hands rest: one that
    went on would press against the arm, and who presses is held and cannot step back.
    """
    n = len(yaw)
    moved, walked, speed = np.empty((n, 3)), np.empty(n), np.empty(n)
    passed, left = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    for m in range(n):
        of, x, y = limits[int(traits[m, 0] * len(limits))], there[m, 0], there[m, 1]
        passed[m], left[m] = steps[m] + 1, max(retreat[m] - 1, 0)
        if retreat[m] > 0 and of[RETREAT_SPEED] > 0.0:
            ax, ay, least = 0.0, 0.0, np.inf
            for index in range(arm.shape[1]):
                dx, dy = position[m, 0] - arm[m, index, 0], position[m, 1] - arm[m, index, 1]
                distance = math.sqrt(dx * dx + dy * dy)
                if distance < least:
                    ax, ay, least = dx, dy, distance
            size, pace = max(least, 1e-9), of[RETREAT_SPEED] if retreat[m] > WAIT_STEPS else 0.0
            x, y = stepped(
                position[m, 0], position[m, 1], velocity[m, 0], velocity[m, 1], ax / size * pace, ay / size * pace,
                discs[m], radius_m, np.inf, of[RETREAT_ACCELERATION],
            )  # fmt: skip
            facing[m] = turned(yaw[m], velocity[m, 2], yaw[m])
            for axis in range(3):
                kept[m, axis] = memory[m, axis]
                for limb in range(6):
                    bent[m, limb, axis] = limbs[m, limb, axis]
        if of[FREE] == 0.0:
            x, y = held(x, y, position[m], spawn[m], discs[m], radius_m, of[BOUND])
        there[m, 0], there[m, 1] = x, y
        dx, dy = x - position[m, 0], y - position[m, 1]
        way, turn = math.sqrt(dx * dx + dy * dy), (facing[m] - yaw[m] + math.pi) % (2 * math.pi) - math.pi
        moved[m, 0], moved[m, 1], moved[m, 2] = dx / CONTROL_STEP_S, dy / CONTROL_STEP_S, turn / CONTROL_STEP_S
        walked[m] = walked_m[m] + way
        speed[m] = speed_m_s[m] + smoothing * (way / CONTROL_STEP_S - speed_m_s[m])
    return moved, walked, speed, passed, left


@kernel
def reach(
    hand: tuple[float, float, float], shoulder: Array, pole: Array, upper: Array, fore: Array, upper_m: float,
    fore_m: float, nearest_m: float, farthest_m: float,
) -> None:  # fmt: skip
    """See `body.reaching`: of one arm, whose elbow points to `pole` (3,)."""
    ox, oy, oz = hand[0] - shoulder[0], hand[1] - shoulder[1], hand[2] - shoulder[2]
    far = math.sqrt(ox * ox + oy * oy + oz * oz)
    size = max(far, 1e-9)
    ax, ay, az = ox / size, oy / size, oz / size
    far = min(max(far, nearest_m), farthest_m)
    forth = (far * far + upper_m * upper_m - fore_m * fore_m) / (2 * far)
    aside = math.sqrt(upper_m * upper_m - forth * forth)
    px, py, pz = pole
    along = px * ax + py * ay + pz * az
    px, py, pz = px - along * ax, py - along * ay, pz - along * az
    size = max(math.sqrt(px * px + py * py + pz * pz), 1e-9)
    ex, ey, ez = forth * ax + aside * px / size, forth * ay + aside * py / size, forth * az + aside * pz / size
    upper[0], upper[1], upper[2] = ex / upper_m, ey / upper_m, ez / upper_m
    fore[0], fore[1], fore[2] = (far * ax - ex) / fore_m, (far * ay - ey) / fore_m, (far * az - ez) / fore_m


@kernel
def reaching(
    hands: Array, shoulders: Array, pole: Array, upper_m: float, fore_m: float, nearest_m: float, farthest_m: float
) -> Array:
    """See `body.reaching`; `pole` (2, 3) is where the elbows point."""
    limbs = np.full((len(hands), 6, 3), np.nan)
    for m in range(len(hands)):
        for side in range(2):
            hand = hands[m, side, 0], hands[m, side, 1], hands[m, side, 2]
            upper, fore = limbs[m, 2 + side], limbs[m, 4 + side]
            reach(hand, shoulders[side], pole[side], upper, fore, upper_m, fore_m, nearest_m, farthest_m)
    return limbs
