"""Distance of arm and person, and how fast the arm closes it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import contiguous, plain
from hrl_comfort.safety import kernels
from hrl_comfort.safety.geometry import (
    ArmGeometry,
    ArmPose,
    PersonGeometry,
    closest_points,
    dot,
    gaps,
    norm,
    turns,
)
from hrl_comfort.safety.pair_kernels import pairs
from hrl_comfort.scene.human import LIMBS
from hrl_comfort.scene.workcell import Scene

Array = NDArray[np.float64]

UNSAFE_SPEED_M_S = 0.25
"""Largest speed of moving parts that a person may reach without separation (reduced speed: ISO 10218-1:2011, 5.6.2,
of the tool; ISO 10218-2:2025, 5.5.6.1, of all accessible parts). Touches below it are what ISO/TS 15066:2016, 5.5.4,
allows once the protective distance is used up."""
TOUCH_M = 1e-6
"""Distance at which capsules count as touching, more than rounding."""


@dataclass(frozen=True)
class Encounter:
    """Arms and people of N cells at one instant."""

    pose: ArmPose
    person: Array
    """(3, P, 2, N) m, ends of the axes of the capsules of all people."""
    apart: Array
    """(C, N) m, distance of each of the arm's capsules from the nearest person, negative in overlap."""


class Separation:
    """Distances and speeds between the capsules of arm and person, for N cells at once."""

    def __init__(self, scene: Scene) -> None:
        self.arm, self.person = ArmGeometry(scene), PersonGeometry(scene)
        bodies = [scene.limbs[at : at + len(LIMBS)] for at in range(0, len(scene.limbs), len(LIMBS))]
        self.each = [PersonGeometry(scene, names) for names in bodies] if len(bodies) > 1 else [self.person]
        """Each person by itself; `person` is the union of their capsules, in their order."""

    def encounter(self, angles: Array, limbs: Array) -> Encounter:
        """Return arms at `angles` (N, J) rad beside people at `limbs` (N, L, 7)."""
        return self.beside(angles, self.person.ends(limbs))

    def beside(self, angles: Array, person: Array) -> Encounter:
        """Return arms at `angles` (N, J) rad beside people whose capsules have their ends at `person` (3, P, 2, N)."""
        arm = self.arm
        if plain(angles, person):
            *pose, apart = kernels.beside(
                *turns(angles), *arm.compiled, *contiguous(person), arm.radius, self.person.radius
            )
            return Encounter(ArmPose(*pose), person, apart)
        there = arm.pose(angles)
        return Encounter(there, person, gaps(arm, there.ends, self.person, person))

    def gap(self, angles: Array, limbs: Array) -> Array:
        """Return the distance (N,) m of arms at `angles` (N, J) rad from people at `limbs` (N, L, 7).

        Negative in overlap.
        """
        gap: Array = self.encounter(angles, limbs).apart.min(axis=0)
        return gap

    def touch(self, angles: Array, limbs: Array) -> NDArray[np.bool_]:
        """Return (N, C, P) which pairs of capsules touch: arms at `angles` (N, J) rad, people at `limbs` (N, L, 7)."""
        apart, _ = self.pairs(angles, np.zeros_like(angles), limbs)
        return apart.transpose(2, 0, 1) <= TOUCH_M

    def pairs(self, angles: Array, velocity: Array, limbs: Array) -> tuple[Array, Array]:
        """Return the distance (C, P, N) m of each pair of capsules, and how fast (C, P, N) m/s the arm's closes it.

        `angles` (N, J) rad and `velocity` (N, J) rad/s are those before a contact pushes the arm, `limbs` (N, L, 7) the
        person then. The person's own motion does not count; negative where the arm draws back.
        """
        arm, person = self.arm, self.person
        pose, limb = arm.pose(angles), person.ends(limbs)
        if plain(pose.ends, velocity, limb):
            given = contiguous(pose.axis, pose.anchor, pose.ends, velocity, limb)
            return pairs(*given, arm.link, arm.radius, person.radius)  # type: ignore[no-any-return]
        axes = pose.ends[:, :, None, 0], pose.ends[:, :, None, 1], limb[:, None, :, 0], limb[:, None, :, 1]
        p, q = closest_points(*axes)
        apart = norm(q - p) - (arm.radius[:, None, None] + person.radius[:, None])
        towards = (q - p) / np.maximum(norm(q - p), 1e-9)
        points = p + towards * arm.radius[:, None, None]
        return apart, dot(arm.point_velocity(pose, velocity, points), towards)
