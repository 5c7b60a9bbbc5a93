"""Compiled twin of `Clearance.keeps`; see `hrl_comfort.compiled`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import kernel
from hrl_comfort.safety.kernels import Geometry, axes_apart, posed

Array = NDArray[np.float64]
CLOSER_M = 1e-6
"""Change of a distance that counts as nearer."""


@kernel
def over(ends: Array, m: int, capsule: int, shares: Array, column: Array) -> float:
    """Return the distance, m, of the axis of a capsule of arm `m` from a column, measured at `shares` of the axis.

    `column` (7,): middle of its top (3) m, half sides (2) m, cosine and sine of its turn; the post has a radius, and 0.
    """
    x, y, z = ends[0, capsule, 0, m], ends[1, capsule, 0, m], ends[2, capsule, 0, m]
    dx, dy, dz = ends[0, capsule, 1, m] - x, ends[1, capsule, 1, m] - y, ends[2, capsule, 1, m] - z
    x, y, z, cos, sin, nearest = x - column[0], y - column[1], z - column[2], column[5], column[6], np.inf
    for share in shares:
        a, b = x + dx * share, y + dy * share
        if column[4] > 0.0:
            u, v = max(abs(cos * a + sin * b) - column[3], 0.0), max(abs(cos * b - sin * a) - column[4], 0.0)
        else:
            u, v = max(np.sqrt(a * a + b * b) - column[3], 0.0), 0.0
        w = max(z + dz * share, 0.0)
        nearest = min(np.sqrt(u * u + v * v + w * w), nearest)
    return nearest


@kernel
def between(ends: Array, first: int, second: int, m: int) -> float:
    """Return the distance, m, between the axes of two capsules of arm `m`."""
    px, py, pz = ends[0, first, 0, m], ends[1, first, 0, m], ends[2, first, 0, m]
    qx, qy, qz = ends[0, second, 0, m], ends[1, second, 0, m], ends[2, second, 0, m]
    return axes_apart(
        px, py, pz, ends[0, first, 1, m] - px, ends[1, first, 1, m] - py, ends[2, first, 1, m] - pz,
        qx, qy, qz, ends[0, second, 1, m] - qx, ends[1, second, 1, m] - qy, ends[2, second, 1, m] - qz,
    )  # fmt: skip


@kernel
def keeps(
    begin: Array, end: Array, tops: Array, geometry: Geometry, radius: Array, begins: NDArray[np.int64], along: Array,
    pairs: NDArray[np.int64], posts: Array, floor_z: float, clearance_m: float,
) -> NDArray[np.bool_]:  # fmt: skip
    """See `Clearance.keeps`; then come fields of it and of the arm."""
    here, there = posed(begin, geometry)[2], posed(end, geometry)[2]
    link, kept = geometry[4], np.ones(len(begin), dtype=np.bool_)
    count, column = tops.shape[1], np.zeros((tops.shape[1] + len(posts), 7))
    for index in range(len(posts)):
        column[count + index, 3], column[count + index, 2] = posts[index, 0], posts[index, 1]
    for m in range(len(begin)):
        for index in range(count):
            column[index, :5] = tops[m, index, :5]
            column[index, 5], column[index, 6] = np.cos(tops[m, index, 5]), np.sin(tops[m, index, 5])
        for capsule in range(len(radius)):
            shares, near = along[begins[capsule] : begins[capsule + 1]], radius[capsule] + clearance_m
            lowest = min(there[2, capsule, 0, m], there[2, capsule, 1, m])
            before = min(here[2, capsule, 0, m], here[2, capsule, 1, m])
            kept[m] &= lowest - floor_z >= near or lowest >= before - CLOSER_M  # NaN is not
            for index in range(len(column)):
                meets = index < count or link[capsule] >= posts[index - count, 2]
                if meets and not lowest - column[index, 2] >= near:  # else all of it is well above the top
                    gap = over(there, m, capsule, shares, column[index])
                    if not gap >= near:
                        kept[m] &= gap >= over(here, m, capsule, shares, column[index]) - CLOSER_M
        for index in range(len(pairs)):
            a, b = pairs[index]
            gap = between(there, a, b, m)
            if not gap >= radius[a] + radius[b] + clearance_m:
                kept[m] &= gap >= between(here, a, b, m) - CLOSER_M
    return kept
