"""Compiled twins of functions of `Clearance`; see `hrl_comfort.compiled`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import kernel
from hrl_comfort.safety.kernels import Geometry, closest_shares, posed

Array = NDArray[np.float64]
Surroundings = tuple[NDArray[np.int64], Array, NDArray[np.int64], Array, float]
"""Of the fields of `Clearance`: capsules and shares of the points, pairs, posts, and height of the floor."""
CLOSER_M = 1e-9
"""Change of a distance that counts as nearer."""


@kernel
def columns_of(tops: Array, m: int, posts: Array) -> Array:
    """Return the columns (F + posts, 7) of cell `m`: middle of the top (3) m, half sides (2) m, cosine, sine of turn.

    A post is round: its first half side is its radius, its second one 0.
    """
    count = tops.shape[1]
    found = np.zeros((count + len(posts), 7))
    for index in range(count):
        found[index, :5] = tops[m, index, :5]
        found[index, 5], found[index, 6] = np.cos(tops[m, index, 5]), np.sin(tops[m, index, 5])
    for index in range(len(posts)):
        found[count + index, 3], found[count + index, 2] = posts[index, 0], posts[index, 1]
    return found


@kernel
def away(x: float, y: float, z: float, column: Array) -> tuple[float, float, float]:
    """Return the vector, m, to a point from the nearest point of a column, which is solid from its top down."""
    x, y, up, cos, sin = x - column[0], y - column[1], max(z - column[2], 0.0), column[5], column[6]
    if column[4] > 0.0:
        u, v = cos * x + sin * y, cos * y - sin * x
        u -= min(max(u, -column[3]), column[3])
        v -= min(max(v, -column[4]), column[4])
        return cos * u - sin * v, sin * u + cos * v, up
    share = max(1 - column[3] / max(np.sqrt(x * x + y * y), 1e-9), 0.0)
    return x * share, y * share, up


@kernel
def at(ends: Array, m: int, capsule: int, share: float) -> tuple[float, float, float]:
    """Return the point, m, at `share` of the axis of a capsule of arm `m`."""
    x, y, z = ends[0, capsule, 0, m], ends[1, capsule, 0, m], ends[2, capsule, 0, m]
    return (
        x + (ends[0, capsule, 1, m] - x) * share, y + (ends[1, capsule, 1, m] - y) * share,
        z + (ends[2, capsule, 1, m] - z) * share,
    )  # fmt: skip


@kernel
def between(ends: Array, m: int, first: int, second: int) -> tuple[float, float]:
    """Return the shares of the axes of two capsules of arm `m` at which they are nearest to each other."""
    px, py, pz = at(ends, m, first, 0.0)
    qx, qy, qz = at(ends, m, second, 0.0)
    x, y, z = at(ends, m, first, 1.0)
    u, v, w = at(ends, m, second, 1.0)
    return closest_shares(px, py, pz, x - px, y - py, z - pz, qx, qy, qz, u - qx, v - qy, w - qz)


@kernel
def length(x: float, y: float, z: float) -> float:
    """Return the length of a vector."""
    return math.sqrt(x * x + y * y + z * z)


@kernel
def apart(ends: Array, m: int, first: int, second: int) -> float:
    """Return the distance, m, of the axes of two capsules of arm `m`."""
    s, t = between(ends, m, first, second)
    x, y, z = at(ends, m, first, s)
    u, v, w = at(ends, m, second, t)
    return length(x - u, y - v, z - w)


@kernel
def keeps(
    begin: Array, end: Array, tops: Array, geometry: Geometry, radius: Array, around: Surroundings, clearance_m: float
) -> NDArray[np.bool_]:
    """See `Clearance.keeps`; then come fields of it and of the arm. What is not a number keeps nothing."""
    capsules, shares, pairs, posts, floor_z = around
    here, there = posed(begin, geometry)[2], posed(end, geometry)[2]
    link, kept, count = geometry[4], np.ones(len(begin), dtype=np.bool_), tops.shape[1]
    for m in range(len(begin)):
        columns = columns_of(tops, m, posts)
        for index in range(len(capsules)):
            capsule, near = capsules[index], radius[capsules[index]] + clearance_m
            x, y, z = at(there, m, capsule, shares[index])
            kept[m] &= z - floor_z >= near or z >= at(here, m, capsule, shares[index])[2] - CLOSER_M
            for k in range(len(columns)):
                meets = k < count or link[capsule] >= posts[k - count, 2]
                if meets and not z - columns[k, 2] >= near:
                    gap = length(*away(x, y, z, columns[k]))
                    if not gap >= near:
                        u, v, w = at(here, m, capsule, shares[index])
                        kept[m] &= gap >= length(*away(u, v, w, columns[k])) - CLOSER_M
        for index in range(len(pairs)):
            first, second = pairs[index]
            gap = apart(there, m, first, second)
            near = radius[first] + radius[second] + clearance_m
            kept[m] &= gap >= near or gap >= apart(here, m, first, second) - CLOSER_M
    return kept


@kernel
def lean(
    row: Array, m: int, axis: Array, anchor: Array, link: int, x: float, y: float, z: float,
    u: float, v: float, w: float, sign: float,
) -> None:  # fmt: skip
    """Add to `row` (J,) how fast the point x, y, z of a link of arm `m` moves along u, v, w for each joint's rate."""
    for j in range(link + 1):
        dx, dy, dz = x - anchor[0, j, m], y - anchor[1, j, m], z - anchor[2, j, m]
        a, b, c = axis[0, j, m], axis[1, j, m], axis[2, j, m]
        row[j] += sign * ((b * dz - c * dy) * u + (c * dx - a * dz) * v + (a * dy - b * dx) * w)


@kernel
def damped(
    angles: Array, asked: Array, tops: Array, geometry: Geometry, radius: Array, around: Surroundings,
    clearance_m: float, damping_s: float, reach_m: float, rounds: int,
) -> Array:  # fmt: skip
    """See `Clearance.damped`."""
    capsules, shares, pairs, posts, floor_z = around
    axis, anchor, ends = posed(angles, geometry)
    link, count, found = geometry[4], tops.shape[1], asked.copy()
    most = len(capsules) * (count + len(posts) + 1) + len(pairs)
    rows, room = np.empty((most, angles.shape[1])), np.empty(most)
    for m in range(len(angles)):
        known, columns = 0, columns_of(tops, m, posts)
        for index in range(len(capsules)):
            capsule, near = capsules[index], radius[capsules[index]] + clearance_m
            x, y, z = at(ends, m, capsule, shares[index])
            for k in range(len(columns) + 1):
                if k == len(columns):
                    u, v, w, gap = 0.0, 0.0, 1.0, z - floor_z
                elif (k >= count and link[capsule] < posts[k - count, 2]) or z - columns[k, 2] >= near + reach_m:
                    continue
                else:
                    u, v, w = away(x, y, z, columns[k])
                    gap = length(u, v, w)
                    u, v, w = (u / gap, v / gap, w / gap) if gap > 0.0 else (0.0, 0.0, 1.0)
                if gap < near + reach_m:
                    rows[known], room[known] = 0.0, max(gap - near, 0.0) / damping_s
                    lean(rows[known], m, axis, anchor, link[capsule], x, y, z, u, v, w, 1.0)
                    known += 1
        for index in range(len(pairs)):
            first, second = pairs[index]
            s, t = between(ends, m, first, second)
            x, y, z = at(ends, m, first, s)
            a, b, c = at(ends, m, second, t)
            gap, near = length(x - a, y - b, z - c), radius[first] + radius[second] + clearance_m
            if 0.0 < gap < near + reach_m:
                u, v, w = (x - a) / gap, (y - b) / gap, (z - c) / gap
                rows[known], room[known] = 0.0, max(gap - near, 0.0) / damping_s
                lean(rows[known], m, axis, anchor, link[first], x, y, z, u, v, w, 1.0)
                lean(rows[known], m, axis, anchor, link[second], a, b, c, u, v, w, -1.0)
                known += 1
        for _ in range(rounds):
            worst, least = -1, 0.0
            for index in range(known):
                slack = room[index] + (rows[index] * found[m]).sum()
                if slack < least:
                    worst, least = index, slack
            if worst < 0:
                break
            found[m] -= rows[worst] * (least / max((rows[worst] * rows[worst]).sum(), 1e-9))
    return found
