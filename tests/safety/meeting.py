"""People who meet an arm, by numpy: the definition of `safety.people_kernels`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hrl_comfort import humans
from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.humans.arms import BACK_M_S, FIRST_ARM
from hrl_comfort.humans.body import FOREARM_M, UPPER_ARM_M
from hrl_comfort.safety.geometry import ArmGeometry, PersonGeometry, closest_points, farthest, gaps, norm
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.controls import limbs_of
from hrl_comfort.sim.people import share_walked
from tests.humans.around import begin_retreat

Array = NDArray[np.float64]


def stopped(
    scene: Scene, arm: ArmGeometry, person: PersonGeometry, ends: Array, there: Array, before: humans.Walk,
    walk: humans.Walk, leaving: NDArray[np.bool_],
) -> tuple[humans.Walk, Array, Array, float]:  # fmt: skip
    """Return the walk, limbs, ends of capsules and farthest way of one `person` per cell; see `people.stop_at_contact`.

    The capsules of the arms have their ends at `ends` (3, C, 2, N), those of the people `before` at `there`.
    """
    limbs = limbs_of(scene, walk)
    after = person.ends(limbs)
    gap = gaps(arm, ends, person, after).min(axis=0)
    touched = np.flatnonzero(gap <= 0.0)
    walk = begin_retreat(walk, touched)
    room = gaps(arm, ends[..., touched], person, there[..., touched]).min(axis=0)
    share = share_walked(room, gap[touched])
    stops = np.flatnonzero(share < 1.0)
    at = touched[stops]
    stood = before.rows(at)
    place = stood.position + share[stops, None] * (walk.position[at] - stood.position)
    held = replace(stood, position=place, velocity=np.zeros_like(stood.velocity), retreat=walk.retreat[at])
    back = _drawn_back(scene, arm, person, ends[..., at], held)
    held = replace(held, limbs=np.where(leaving[at, None, None], back, held.limbs))
    way = farthest(after, there).max(initial=0.0)
    limbs[at] = limbs_of(scene, held)
    after[..., at] = person.ends(limbs[at])
    return walk.put(at, held), limbs, after, max(way, farthest(after[..., at], there[..., at]).max(initial=0.0))


def _drawn_back(scene: Scene, arm: ArmGeometry, person: PersonGeometry, ends: Array, held: humans.Walk) -> Array:
    now = person.ends(limbs_of(scene, held))
    part, away = nearest_part(arm, ends, person, now)
    back = drawn_back(held.limbs, held.yaw, person.limb[part], away)
    then = person.ends(limbs_of(scene, replace(held, limbs=back)))
    room, gap = (gaps(arm, ends, person, each).min(axis=0) for each in (now, then))
    return np.where((gap < room)[:, None, None], held.limbs, back)


def drawn_back(limbs: Array, yaw: Array, touched: NDArray[np.int64], away: Array) -> Array:
    """Return the limbs (n, 6, 3) of people at `yaw` (n,) rad; see `humans.arms.drawn_back`."""
    cos, sin, (x, y, z) = np.cos(yaw), np.sin(yaw), away.T
    step = np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=1)
    step *= BACK_M_S * CONTROL_STEP_S / (UPPER_ARM_M + FOREARM_M)
    moved = limbs.copy()
    rows = np.flatnonzero(touched >= FIRST_ARM)
    upper = 2 + (touched[rows] - FIRST_ARM) % 2
    for limb in (upper, upper + 2):
        vector = limbs[rows, limb] + step[rows]
        moved[rows, limb] = vector / np.linalg.norm(vector, axis=1, keepdims=True)
    return moved


def nearest_part(
    arm: ArmGeometry, ends: Array, person: PersonGeometry, limbs: Array
) -> tuple[NDArray[np.int64], Array]:
    """See `pair_kernels.nearest_part`."""
    on_arm, on_person = closest_points(
        ends[:, :, None, 0], ends[:, :, None, 1], limbs[:, None, :, 0], limbs[:, None, :, 1]
    )
    between = (on_person - on_arm).reshape(3, ends.shape[1] * limbs.shape[1], ends.shape[-1])
    apart = norm(between) - (arm.radius[:, None] + person.radius).reshape(-1, 1)
    nearest = apart.argmin(axis=0)
    vector = between[:, nearest, np.arange(len(nearest))]
    return nearest % len(person.radius), (vector / np.maximum(norm(vector), 1e-9)).T
