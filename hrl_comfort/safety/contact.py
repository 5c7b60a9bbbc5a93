"""How a contact of arm and person began: who touched whom, and how fast."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.safety.geometry import ArmGeometry, PersonGeometry, closest_points, norm

Array = NDArray[np.float64]

UNSAFE_SPEED_M_S = 0.25
"""Speed of a robot beside a person that needs no separation (ISO 10218-1, reduced speed)."""


def closing_speed(arm: ArmGeometry, person: PersonGeometry, angles: Array, velocity: Array, limbs: Array) -> Array:
    """Return the speed (N,) m/s at which the arm's point nearest to the person moves towards it.

    `angles` (N, J) rad and `velocity` (N, J) rad/s are those before the contact pushes the arm, `limbs` (N, L, 7)
    the person then. The person's own motion does not count; negative where the arm draws back.
    """
    pose, limb = arm.pose(angles), person.ends(limbs)
    p, q = closest_points(pose.ends[:, :, None, 0], pose.ends[:, :, None, 1], limb[:, None, :, 0], limb[:, None, :, 1])
    apart = norm(q - p) - np.add.outer(arm.radius, person.radius)[..., None]
    rows = np.arange(apart.shape[-1])
    part, other = np.unravel_index(apart.reshape(-1, len(rows)).argmin(axis=0), apart.shape[:2])
    p, q = p[:, part, other, rows], q[:, part, other, rows]
    towards = (q - p) / np.maximum(norm(q - p), 1e-9)
    point = p + towards * arm.radius[part]
    return np.asarray((arm.point_velocity(pose, velocity, part, point) * towards).sum(axis=0))
