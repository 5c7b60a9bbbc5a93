"""Compiled twins of functions of `sight`; see `hrl_comfort.compiled`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import kernel

Array = NDArray[np.float64]


@kernel
def closest(bodies: Array, others: Array, moving: Array) -> tuple[Array, Array, Array]:
    """See `sight.closest`."""
    n, parts, count = len(bodies), bodies.shape[1], others.shape[1]
    gaps, vectors, speeds = np.empty((n, parts)), np.empty((n, parts, 3)), np.empty((n, parts))
    for m in range(n):
        for part in range(parts):
            px, py, pz, x, y, z, thick = bodies[m, part]
            dx, dy, dz = x - px, y - py, z - pz
            aa = max(dx * dx + dy * dy + dz * dz, 1e-12)
            least, other, along = np.inf, 0, 0.0
            ux, uy, uz = 0.0, 0.0, 0.0
            for index in range(count):
                qx, qy, qz, x, y, z, thickness = others[m, index]
                ex, ey, ez = x - qx, y - qy, z - qz
                rx, ry, rz = px - qx, py - qy, pz - qz
                ee = max(ex * ex + ey * ey + ez * ez, 1e-12)
                b = dx * ex + dy * ey + dz * ez
                c = dx * rx + dy * ry + dz * rz
                f = ex * rx + ey * ry + ez * rz
                slant = aa * ee - b * b
                s = min(max((b * f - c * ee) / slant, 0.0), 1.0) if slant > 1e-12 else 0.0
                t = min(max((b * s + f) / ee, 0.0), 1.0)
                s = min(max((b * t - c) / aa, 0.0), 1.0)
                vx, vy, vz = qx + ex * t - px - dx * s, qy + ey * t - py - dy * s, qz + ez * t - pz - dz * s
                gap = math.sqrt(vx * vx + vy * vy + vz * vz) - thick - thickness
                if gap < least:
                    least, other, along, ux, uy, uz = gap, index, t, vx, vy, vz
            towards = 0.0
            for axis, way in enumerate((ux, uy, uz)):
                begin, end = moving[m, other, axis], moving[m, other, 3 + axis]
                towards -= (begin + (end - begin) * along) * way
                vectors[m, part, axis] = way
            gaps[m, part] = least
            speeds[m, part] = towards / max(math.sqrt(ux * ux + uy * uy + uz * uz), 1e-6)
    return gaps, vectors, speeds
