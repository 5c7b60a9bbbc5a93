"""Compiled twins of the functions with which people move; see `hrl_comfort.compiled`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import kernel
from hrl_comfort.config import CONTROL_STEP_S

Array = NDArray[np.float64]


@kernel
def step(
    position: Array,
    velocity: Array,
    wanted: Array,
    centres: Array,
    clear_m: float,
    margin_m: float,
    leave_s: float,
    speed_m_s: float,
    acceleration_m_s2: float,
) -> Array:
    """See `steering.step`: discs of radius `clear_m` with a margin that is left in `leave_s`."""
    n, discs = centres.shape[:2]
    there, brake = np.empty((n, 2)), 2 * (acceleration_m_s2 / 4)
    away, allowed = np.empty((discs, 2)), np.empty(discs)
    for m in range(n):
        wx, wy, turns = wanted[m, 0], wanted[m, 1], False
        for disc in range(discs):
            dx, dy = position[m, 0] - centres[m, disc, 0], position[m, 1] - centres[m, disc, 1]
            distance = max(math.sqrt(dx * dx + dy * dy), 1e-9)
            away[disc, 0], away[disc, 1] = dx / distance, dy / distance
            gap = distance - clear_m - margin_m
            allowed[disc] = math.sqrt(brake * max(gap, 0.0)) + min(gap, 0.0) / leave_s
            turns |= -(wx * away[disc, 0] + wy * away[disc, 1]) > allowed[disc]
        if turns:
            for disc in range(discs):
                ax, ay = away[disc]
                inwards = -(wx * ax + wy * ay)
                excess = max(inwards - allowed[disc], 0.0)
                way = -1.0 if wx * -ay + wy * ax < 0 else 1.0
                aside = (excess if inwards > 0 else 0.0) * way
                wx, wy = wx + excess * ax + aside * -ay, wy + excess * ay + aside * ax
        share = min(1.0, speed_m_s / max(math.sqrt(wx * wx + wy * wy), 1e-9))
        cx, cy = wx * share - velocity[m, 0], wy * share - velocity[m, 1]
        share = min(1.0, acceleration_m_s2 * CONTROL_STEP_S / max(math.sqrt(cx * cx + cy * cy), 1e-9))
        there[m, 0] = position[m, 0] + (velocity[m, 0] + cx * share) * CONTROL_STEP_S
        there[m, 1] = position[m, 1] + (velocity[m, 1] + cy * share) * CONTROL_STEP_S
    return there


@kernel
def turn(yaw: Array, rate: Array, wanted: Array, fastest: float, change: float) -> Array:
    """See `steering.turn`: turning at up to `fastest` rad/s, which changes by up to `change` rad/s²."""
    after, brake = np.empty(len(yaw)), change * CONTROL_STEP_S
    for m in range(len(yaw)):
        left = (wanted[m] - yaw[m] + math.pi) % (2 * math.pi) - math.pi
        size = min(fastest, math.sqrt(brake * brake + 2 * change * abs(left)) - brake)
        asked = (size if left > 0 else -size if left < 0 else 0.0) - rate[m]
        after[m] = yaw[m] + (rate[m] + min(max(asked, -brake), brake)) * CONTROL_STEP_S
    return after


@kernel
def held(position: Array, before: Array, spawn: Array, centres: Array, radius_m: float, bound_m: float) -> Array:
    """See `humans._held`."""
    n, discs = centres.shape[:2]
    after = np.empty((n, 2))
    for m in range(n):
        dx, dy = position[m, 0] - spawn[m, 0], position[m, 1] - spawn[m, 1]
        shrink = min(1.0, bound_m / max(math.sqrt(dx * dx + dy * dy), 1e-9))
        x, y = spawn[m, 0] + dx * shrink, spawn[m, 1] + dy * shrink
        nearest, least = 0, np.inf
        for disc in range(discs):
            dx, dy = x - centres[m, disc, 0], y - centres[m, disc, 1]
            distance = math.sqrt(dx * dx + dy * dy)
            if distance < least:
                nearest, least = disc, distance
        if least < radius_m:
            cx, cy = centres[m, nearest]
            span = max(least, 1e-9)
            x, y = cx + (x - cx) / span * (radius_m + 1e-9), cy + (y - cy) / span * (radius_m + 1e-9)
            dx, dy = x - spawn[m, 0], y - spawn[m, 1]
            stays = math.sqrt(dx * dx + dy * dy) > bound_m + 1e-9
            for disc in range(discs):
                dx, dy = x - centres[m, disc, 0], y - centres[m, disc, 1]
                stays |= math.sqrt(dx * dx + dy * dy) < radius_m
            if stays:
                x, y = before[m]
        after[m, 0], after[m, 1] = x, y
    return after


@kernel
def gone(
    position: Array, yaw: Array, position_before: Array, yaw_before: Array, walked_m: Array, speed_m_s: Array,
    smoothing: float,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """See `humans._gone`."""
    n = len(yaw)
    velocity, walked, speed = np.empty((n, 3)), np.empty(n), np.empty(n)
    for m in range(n):
        dx, dy = position[m, 0] - position_before[m, 0], position[m, 1] - position_before[m, 1]
        way = math.sqrt(dx * dx + dy * dy)
        turned = (yaw[m] - yaw_before[m] + math.pi) % (2 * math.pi) - math.pi
        velocity[m, 0], velocity[m, 1] = dx / CONTROL_STEP_S, dy / CONTROL_STEP_S
        velocity[m, 2] = turned / CONTROL_STEP_S
        walked[m] = walked_m[m] + way
        speed[m] = speed_m_s[m] + smoothing * (way / CONTROL_STEP_S - speed_m_s[m])
    return velocity, walked, speed


@kernel
def reaching(
    hands: Array, shoulders: Array, pole: Array, upper_m: float, fore_m: float, nearest_m: float, farthest_m: float
) -> Array:
    """See `body.reaching`; `pole` (2, 3) is where the elbows point."""
    limbs = np.full((len(hands), 6, 3), np.nan)
    for m in range(len(hands)):
        for side in range(2):
            ox = hands[m, side, 0] - shoulders[side, 0]
            oy = hands[m, side, 1] - shoulders[side, 1]
            oz = hands[m, side, 2] - shoulders[side, 2]
            far = math.sqrt(ox * ox + oy * oy + oz * oz)
            size = max(far, 1e-9)
            ax, ay, az = ox / size, oy / size, oz / size
            far = min(max(far, nearest_m), farthest_m)
            forth = (far * far + upper_m * upper_m - fore_m * fore_m) / (2 * far)
            aside = math.sqrt(upper_m * upper_m - forth * forth)
            px, py, pz = pole[side]
            along = px * ax + py * ay + pz * az
            px, py, pz = px - along * ax, py - along * ay, pz - along * az
            size = max(math.sqrt(px * px + py * py + pz * pz), 1e-9)
            ex, ey, ez = forth * ax + aside * px / size, forth * ay + aside * py / size, forth * az + aside * pz / size
            upper, fore = limbs[m, 2 + side], limbs[m, 4 + side]
            upper[0], upper[1], upper[2] = ex / upper_m, ey / upper_m, ez / upper_m
            fore[0], fore[1], fore[2] = (far * ax - ex) / fore_m, (far * ay - ey) / fore_m, (far * az - ez) / fore_m
    return limbs
