"""Compiled twins of the functions of `geometry`; see `hrl_comfort.compiled`.

Loops over the N cells are innermost, where the compiler vectorises them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import kernel
from hrl_comfort.scene.kernels import Body, walkers_limbs

Array = NDArray[np.float64]
Geometry = tuple[Array, Array, Array, Array, NDArray[np.int64], Array]


@kernel
def pose(
    sine: Array,
    versine: Array,
    steps: Array,
    offset: Array,
    axis: Array,
    anchor: Array,
    link: NDArray[np.int64],
    local: Array,
) -> tuple[Array, Array, Array]:
    """See `ArmGeometry.pose`: of `sine` and `versine` (J, N), 1 less the cosine, and fields of the geometry."""
    joints, n = sine.shape
    anchors, axes, ends = np.empty((3, joints, n)), np.empty((3, joints, n)), np.empty((3, len(link), 2, n))
    before, turn, step, here = np.zeros((3, 3, n)), np.empty((3, 3, n)), np.empty((3, 3, n)), np.zeros((3, n))
    for i in range(3):
        before[i, i] = 1.0
    for j in range(joints):
        for i in range(3):
            for k in range(3):
                fixed, first, second = steps[0, i, k, j], steps[1, i, k, j], steps[2, i, k, j]
                for m in range(n):
                    step[i, k, m] = fixed + sine[j, m] * first + versine[j, m] * second
        x, y, z = offset[j]
        for i in range(3):
            for m in range(n):
                anchors[i, j, m] = here[i, m] + (before[i, 0, m] * x + before[i, 1, m] * y + before[i, 2, m] * z)
            for k in range(3):
                for m in range(n):
                    turn[i, k, m] = (
                        before[i, 0, m] * step[0, k, m]
                        + before[i, 1, m] * step[1, k, m]
                        + before[i, 2, m] * step[2, k, m]
                    )
        x, y, z = anchor[j]
        u, v, w = axis[j]
        for i in range(3):
            for m in range(n):
                here[i, m] = anchors[i, j, m] - (turn[i, 0, m] * x + turn[i, 1, m] * y + turn[i, 2, m] * z)
                axes[i, j, m] = turn[i, 0, m] * u + turn[i, 1, m] * v + turn[i, 2, m] * w
        for part in range(len(link)):
            for end in range(2 if link[part] == j else 0):
                x, y, z = local[part, end]
                for i in range(3):
                    for m in range(n):
                        there = turn[i, 0, m] * x + turn[i, 1, m] * y + turn[i, 2, m] * z
                        ends[i, part, end, m] = here[i, m] + there
        for i in range(3):
            for k in range(3):
                for m in range(n):
                    before[i, k, m] = turn[i, k, m]
    return axes, anchors, ends


@kernel
def posed(angles: Array, geometry: Geometry) -> tuple[Array, Array, Array]:
    """See `ArmGeometry.pose`: of `angles` (N, J), of an arm that is `geometry` as `pose` takes it."""
    n, joints = angles.shape
    sine, versine = np.empty((joints, n)), np.empty((joints, n))
    for j in range(joints):
        for m in range(n):
            sine[j, m], versine[j, m] = np.sin(angles[m, j]), 1 - np.cos(angles[m, j])
    return pose(sine, versine, *geometry)


@kernel
def speeds(axis: Array, anchor: Array, ends: Array, velocity: Array, link: NDArray[np.int64], radius: Array) -> Array:
    """See `ArmGeometry.speeds`."""
    joints, n = axis.shape[1:]
    spin, shift = np.empty((3, joints, n)), np.empty((3, joints, n))
    for j in range(joints):
        for i in range(3):
            a, b = (i + 1) % 3, (i + 2) % 3
            for m in range(n):
                rate = velocity[m, j]
                turning = axis[i, j, m] * rate
                moving = (axis[a, j, m] * anchor[b, j, m] - axis[b, j, m] * anchor[a, j, m]) * rate
                spin[i, j, m] = spin[i, j - 1, m] + turning if j else turning
                shift[i, j, m] = shift[i, j - 1, m] + moving if j else moving
    fastest = np.empty((len(link), n))
    for part in range(len(link)):
        j, thick = link[part], radius[part]
        for m in range(n):
            a, b, c = spin[0, j, m], spin[1, j, m], spin[2, j, m]
            most = -np.inf
            for end in range(2):
                x, y, z = ends[0, part, end, m], ends[1, part, end, m], ends[2, part, end, m]
                u = b * z - c * y - shift[0, j, m]
                v = c * x - a * z - shift[1, j, m]
                w = a * y - b * x - shift[2, j, m]
                speed = np.sqrt(u * u + v * v + w * w)
                most = speed if speed > most else most
            fastest[part, m] = most + thick * np.sqrt(a * a + b * b + c * c)
    return fastest


@kernel
def points(axis: Array, anchor: Array, ends: Array, velocity: Array, link: NDArray[np.int64]) -> tuple[Array, Array]:
    """See `ArmGeometry.points`."""
    (joints, n), parts = axis.shape[1:], len(link)
    at, moving = np.empty((n, 3 * parts, 3)), np.empty((n, 3 * parts, 3))
    spin, shift, here = np.empty((joints, 3)), np.empty((joints, 3)), np.empty(3)
    for m in range(n):
        for j in range(joints):
            rate = velocity[m, j]
            for i in range(3):
                a, b = (i + 1) % 3, (i + 2) % 3
                turning = axis[i, j, m] * rate
                pushing = (axis[a, j, m] * anchor[b, j, m] - axis[b, j, m] * anchor[a, j, m]) * rate
                spin[j, i] = spin[j - 1, i] + turning if j else turning
                shift[j, i] = shift[j - 1, i] + pushing if j else pushing
        for place in range(3):
            for part in range(parts):
                j, index = link[part], place * parts + part
                for i in range(3):
                    first, second = ends[i, part, 0, m], ends[i, part, 1, m]
                    here[i] = at[m, index, i] = (first, (first + second) / 2, second)[place]
                for i in range(3):
                    a, b = (i + 1) % 3, (i + 2) % 3
                    moving[m, index, i] = spin[j, a] * here[b] - spin[j, b] * here[a] - shift[j, i]
    return at, moving


@kernel
def swept(velocity: Array) -> Array:
    """See `ArmGeometry.bending`: what the levers are multiplied with, (N, J)."""
    found = np.empty_like(velocity)
    for m in range(len(velocity)):
        total = 0.0
        for j in range(velocity.shape[1]):
            rate = abs(velocity[m, j])
            total = total + rate if j else rate
            found[m, j] = rate * (rate + 2 * (total - rate))
    return found


@kernel
def limb_ends(limbs: Array, limb: NDArray[np.int64], local: Array) -> Array:
    """See `PersonGeometry.ends`; `local` (P, 2, 3)."""
    n, parts = len(limbs), len(limb)
    ends = np.empty((3, parts, 2, n))
    for part in range(parts):
        for m in range(n):
            at = limbs[m, limb[part]]
            w, x, y, z = at[3], at[4], at[5], at[6]
            for end in range(2):
                a, b, c = local[part, end, 0], local[part, end, 1], local[part, end, 2]
                ends[0, part, end, m] = at[0] + (
                    (1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b + 2 * (x * z + w * y) * c
                )
                ends[1, part, end, m] = at[1] + (
                    2 * (x * y + w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (y * z - w * x) * c
                )
                ends[2, part, end, m] = at[2] + (
                    2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b + (1 - 2 * (x * x + y * y)) * c
                )
    return ends


@kernel
def gaps(ends: Array, limbs: Array, arm_radius: Array, person_radius: Array) -> Array:
    """See `geometry.gaps`."""
    parts, n, others = ends.shape[1], ends.shape[3], limbs.shape[1]
    nearest = np.full((parts, n), np.inf)
    for part in range(parts):
        for other in range(others):
            thick = arm_radius[part] + person_radius[other]
            for m in range(n):
                px, py, pz = ends[0, part, 0, m], ends[1, part, 0, m], ends[2, part, 0, m]
                dx, dy, dz = ends[0, part, 1, m] - px, ends[1, part, 1, m] - py, ends[2, part, 1, m] - pz
                qx, qy, qz = limbs[0, other, 0, m], limbs[1, other, 0, m], limbs[2, other, 0, m]
                ex, ey, ez = limbs[0, other, 1, m] - qx, limbs[1, other, 1, m] - qy, limbs[2, other, 1, m] - qz
                rx, ry, rz = px - qx, py - qy, pz - qz
                aa = dx * dx + dy * dy + dz * dz
                aa = aa if aa > 1e-12 else 1e-12
                ee = ex * ex + ey * ey + ez * ez
                ee = ee if ee > 1e-12 else 1e-12
                b = dx * ex + dy * ey + dz * ez
                c = dx * rx + dy * ry + dz * rz
                f = ex * rx + ey * ry + ez * rz
                denominator = aa * ee - b * b
                s = (b * f - c * ee) / (denominator if denominator > 1e-12 else 1e-12)
                s = s if denominator > 1e-12 else 0.0
                s = s if s > 0.0 else 0.0
                s = s if s < 1.0 else 1.0
                t = (b * s + f) / ee
                t = t if t > 0.0 else 0.0
                t = t if t < 1.0 else 1.0
                s = (b * t - c) / aa
                s = s if s > 0.0 else 0.0
                s = s if s < 1.0 else 1.0
                ux = px + dx * s - (qx + ex * t)
                uy = py + dy * s - (qy + ey * t)
                uz = pz + dz * s - (qz + ez * t)
                gap = np.sqrt(ux * ux + uy * uy + uz * uz) - thick
                least = nearest[part, m]
                nearest[part, m] = least if least <= gap or least != least else gap  # NaN stays
    return nearest


@kernel
def farthest(ends: Array, before: Array) -> Array:
    """See `geometry.farthest`."""
    n, most = ends.shape[3], np.zeros(ends.shape[3])
    for part in range(ends.shape[1]):
        for end in range(2):
            for m in range(n):
                x = ends[0, part, end, m] - before[0, part, end, m]
                y = ends[1, part, end, m] - before[1, part, end, m]
                z = ends[2, part, end, m] - before[2, part, end, m]
                way = np.sqrt(x * x + y * y + z * z)
                most[m] = way if way > most[m] else most[m]
    return most


@kernel
def closest_shares(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float,
    qx: float, qy: float, qz: float, ex: float, ey: float, ez: float,
) -> tuple[float, float]:  # fmt: skip
    """Return the shares of the segments from p by d and from q by e at which they are nearest; see `closest_points`."""
    rx, ry, rz = px - qx, py - qy, pz - qz
    aa, ee = max(dx * dx + dy * dy + dz * dz, 1e-12), max(ex * ex + ey * ey + ez * ez, 1e-12)
    b = dx * ex + dy * ey + dz * ez
    c = dx * rx + dy * ry + dz * rz
    f = ex * rx + ey * ry + ez * rz
    denominator = aa * ee - b * b
    s = (b * f - c * ee) / denominator if denominator > 1e-12 else 0.0
    t = min(max((b * min(max(s, 0.0), 1.0) + f) / ee, 0.0), 1.0)
    return min(max((b * t - c) / aa, 0.0), 1.0), t


@kernel
def nearest_points(
    ends: Array, part: int, limbs: Array, other: int, m: int
) -> tuple[float, float, float, float, float, float]:
    """Return the point on the axis of an arm's capsule that is nearest to one of people, and the vector to that, m."""
    px, py, pz = ends[0, part, 0, m], ends[1, part, 0, m], ends[2, part, 0, m]
    dx, dy, dz = ends[0, part, 1, m] - px, ends[1, part, 1, m] - py, ends[2, part, 1, m] - pz
    qx, qy, qz = limbs[0, other, 0, m], limbs[1, other, 0, m], limbs[2, other, 0, m]
    ex, ey, ez = limbs[0, other, 1, m] - qx, limbs[1, other, 1, m] - qy, limbs[2, other, 1, m] - qz
    s, t = closest_shares(px, py, pz, dx, dy, dz, qx, qy, qz, ex, ey, ez)
    px, py, pz = px + dx * s, py + dy * s, pz + dz * s
    return px, py, pz, qx + ex * t - px, qy + ey * t - py, qz + ez * t - pz


@kernel
def apart_of(ends: Array, part: int, limbs: Array, m: int, arm_radius: Array, person_radius: Array) -> float:
    """Return the distance, m, of one capsule of the arm of cell `m` from the nearest person; see `gaps`."""
    nearest = np.inf
    for other in range(limbs.shape[1]):
        _, _, _, x, y, z = nearest_points(ends, part, limbs, other, m)
        nearest = min(np.sqrt(x * x + y * y + z * z) - (arm_radius[part] + person_radius[other]), nearest)
    return nearest


@kernel
def beside(
    sine: Array, versine: Array, steps: Array, offset: Array, axis: Array, anchor: Array, link: NDArray[np.int64],
    local: Array, person: Array, arm_radius: Array, person_radius: Array,
) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """See `Separation.beside`: the fields of an `ArmPose` as `pose` returns them, and `gaps`."""
    axes, anchors, ends = pose(sine, versine, steps, offset, axis, anchor, link, local)
    return axes, anchors, ends, gaps(ends, person, arm_radius, person_radius)


@kernel
def met(
    ends: Array, apart: Array, person: Array, after: Array, arm_radius: Array, person_radius: Array
) -> tuple[Array, bool, float]:
    """Return how far (N,) m arms are from people who went on; inf if those did not go as far as the arm was.

    `person` and `after` are the ends of their capsules, `apart` (C, N) m is how far each part of the arm was from them.
    Return also whether any of them touch, and how far the end of any capsule went at most.
    """
    way, gap, touching, most = farthest(after, person), np.full(apart.shape[1], np.inf), False, 0.0
    for m in range(len(gap)):
        most = max(way[m], most)
        if apart[:, m].min() <= way[m]:
            for part in range(len(apart)):
                gap[m] = min(apart_of(ends, part, after, m, arm_radius, person_radius), gap[m])
            touching |= gap[m] <= 0.0
    return gap, touching, most


@kernel
def arrive(
    position: Array, yaw: Array, walked_m: Array, speed_m_s: Array, directions: Array, floor_z: float, body: Body,
    limb: NDArray[np.int64], local: Array, ends: Array, apart: Array, person: Array, arm_radius: Array,
    person_radius: Array,
) -> tuple[Array, Array, Array, bool, float]:  # fmt: skip
    """Return `walkers_limbs` of people, the ends of their capsules, and what `met` does."""
    limbs = walkers_limbs(position, yaw, walked_m, speed_m_s, directions, floor_z, *body)
    after = limb_ends(limbs, limb, local)
    gap, touching, most = met(ends, apart, person, after, arm_radius, person_radius)
    return limbs, after, gap, touching, most


@kernel
def approached(
    ends: Array, apart: Array, person: Array, after: Array, arm_radius: Array, person_radius: Array, most_m: float
) -> NDArray[np.bool_]:
    """See `Shield.beyond_bound`: whether people came nearer to a capsule by more than `most_m`."""
    way, nearer = farthest(after, person), np.zeros(apart.shape[1], dtype=np.bool_)
    for m in range(len(nearer)):
        if way[m] > most_m:
            for part in range(len(apart)):
                if apart[part, m] - apart_of(ends, part, after, m, arm_radius, person_radius) > most_m:
                    nearer[m] = True
                    break
    return nearer


@kernel
def capsules(ends: Array, radius: Array) -> Array:
    """See `sim.plan.capsules`."""
    (parts, _, n), width = ends.shape[1:], 7 if len(radius) else 6
    found = np.empty((n, parts, width))
    for m in range(n):
        for part in range(parts):
            for end in range(2):
                for axis in range(3):
                    found[m, part, 3 * end + axis] = ends[axis, part, end, m]
            if len(radius):
                found[m, part, 6] = radius[part]
    return found
