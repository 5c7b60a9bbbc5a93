"""Compiled twins of functions of pairs of capsules; see `hrl_comfort.compiled`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import kernel
from hrl_comfort.safety.kernels import nearest_points

Array = NDArray[np.float64]


@kernel
def nearest_part(ends: Array, limbs: Array, arm_radius: Array, person_radius: Array) -> tuple[NDArray[np.int64], Array]:
    """Return the capsule (N,) of people that is nearest to the arm, and the unit vector (N, 3) from the arm to it.

    The vector joins the nearest points of the axes; it is 0 where these cross. See `geometry.gaps`.
    """
    n = ends.shape[3]
    nearest, away = np.zeros(n, np.int64), np.zeros((n, 3))
    for m in range(n):
        least = np.inf
        for part in range(len(arm_radius)):
            for other in range(len(person_radius)):
                _, _, _, x, y, z = nearest_points(ends, part, limbs, other, m)
                length = np.sqrt(x * x + y * y + z * z)
                gap = length - (arm_radius[part] + person_radius[other])
                if not (gap >= least or np.isnan(least)):  # as argmin, which takes the first that is no number
                    nearest[m], least = other, gap
                    length = max(length, 1e-9)
                    away[m, 0], away[m, 1], away[m, 2] = x / length, y / length, z / length
    return nearest, away


@kernel
def pairs(
    axis: Array, anchor: Array, ends: Array, velocity: Array, person: Array, link: NDArray[np.int64],
    arm_radius: Array, person_radius: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """See `Separation.pairs`: of fields of an `ArmPose` and the ends of people's capsules."""
    (joints, n), parts, others = axis.shape[1:], len(arm_radius), len(person_radius)
    apart, closing = np.empty((parts, others, n)), np.empty((parts, others, n))
    spin, shift = np.zeros((joints, 3)), np.zeros((joints, 3))
    for m in range(n):
        for j in range(joints):
            rate = velocity[m, j]
            for i in range(3):
                a, b = (i + 1) % 3, (i + 2) % 3
                turning = axis[i, j, m] * rate
                pushing = (axis[a, j, m] * anchor[b, j, m] - axis[b, j, m] * anchor[a, j, m]) * rate
                spin[j, i] = spin[j - 1, i] + turning if j else turning
                shift[j, i] = shift[j - 1, i] + pushing if j else pushing
        for part in range(parts):
            (a, b, c), (u, v, w), thick = spin[link[part]], shift[link[part]], arm_radius[part]
            for other in range(others):
                px, py, pz, x, y, z = nearest_points(ends, part, person, other, m)
                length = np.sqrt(x * x + y * y + z * z)
                apart[part, other, m] = length - (thick + person_radius[other])
                length = max(length, 1e-9)
                x, y, z = x / length, y / length, z / length
                px, py, pz = px + x * thick, py + y * thick, pz + z * thick
                closing[part, other, m] = (
                    (b * pz - c * py - u) * x + (c * px - a * pz - v) * y + (a * py - b * px - w) * z
                )
    return apart, closing
