"""Compiled twins of how people meet an arm; see `hrl_comfort.compiled`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import kernel
from hrl_comfort.humans.arms import drawn_back
from hrl_comfort.humans.retreat import RETREAT_STEPS
from hrl_comfort.safety.kernels import apart_of, farthest, limb_ends
from hrl_comfort.safety.pair_kernels import nearest_part
from hrl_comfort.scene.kernels import walkers_limbs

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Moving = tuple[Array, Array, Array, Array, Ints, Array, Array, Array, Ints]
"""Position, yaw, walked_m, speed_m_s, step, velocity, limbs, memory and retreat of a `Walk`."""
Body = tuple[Array, Array, Array, float]
"""`scene.human.BODY`."""
Parts = tuple[Array, Array]
"""Limb (P,) and ends (P, 2, 3) m in its frame of each capsule, as of `PersonGeometry.compiled`."""
OVERLAP_M = 1e-5
"""Depth to which somebody walks into the arm, so that the touch is sensed. People are moved, and push without limit:
from a depth of 1 mm they flung parts that cannot give way at 5 m/s."""


@kernel
def gap_of(ends: Array, limbs: Array, m: int, arm_radius: Array, person_radius: Array) -> float:
    """Return the distance, m, of the arm of cell `m` from the person; see `geometry.gaps`."""
    least = np.inf
    for part in range(len(arm_radius)):
        least = min(apart_of(ends, part, limbs, m, arm_radius, person_radius), least)
    return least


@kernel
def hold(
    walk: Moving, before: Moving, cosine: Array, sine: Array, leaves: NDArray[np.bool_], floor_z: float, body: Body,
    parts: Parts, ends: Array, person: Array, gap: Array, arm_radius: Array, person_radius: Array, limbs: Array,
    after: Array,
) -> float:  # fmt: skip
    """Hold those of `walk` at OVERLAP_M who would walk into the arm; return how far, m, one of their capsules went.

    `walk`, of people `before` and a control step later, is changed, and so are their `limbs` (N, 7, 7) and the ends of
    their capsules, `after` and `gap` (N,) m from the arm, whose capsules have their ends at `ends`; before, `person`
    was where `after` is. All who touch begin a retreat. Those held who leave the arm (`leaves`) draw the hand back that
    it touches, if they can: one that hooks behind the arm would hold its owner, and the arm. `cosine` and `sine` (N,)
    are those of their yaws `before`.
    """
    position, yaw, walked_m, speed_m_s, step, velocity, bent, memory, retreat = walk
    most = 0.0
    for m in range(len(gap)):
        if not gap[m] <= 0.0:
            continue
        retreat[m] = RETREAT_STEPS
        room = gap_of(ends, person, m, arm_radius, person_radius)
        share = min(max((room + OVERLAP_M) / max(room - gap[m], 1e-9), 0.0), 1.0) if gap[m] < room else 1.0
        if not share < 1.0:
            continue
        for axis in range(2):
            stood = before[0][m, axis]
            position[m, axis] = stood + share * (position[m, axis] - stood)
        yaw[m], walked_m[m], speed_m_s[m], step[m] = before[1][m], before[2][m], before[3][m], before[4][m]
        velocity[m], bent[m], memory[m] = 0.0, before[6][m], before[7][m]
        one = slice(m, m + 1)
        still = position[one], yaw[one], walked_m[one], speed_m_s[one]
        arm = np.ascontiguousarray(ends[:, :, :, one])
        pose = walkers_limbs(*still, bent[one], floor_z, *body)
        now = limb_ends(pose, *parts)
        if leaves[m]:
            touched, away = nearest_part(arm, now, arm_radius, person_radius)
            back = drawn_back(bent[m], cosine[m], sine[m], parts[0][touched[0]], away[0])
            moved = walkers_limbs(*still, back.reshape(1, 6, 3), floor_z, *body)
            then = limb_ends(moved, *parts)
            room = gap_of(arm, now, 0, arm_radius, person_radius)
            if not gap_of(arm, then, 0, arm_radius, person_radius) < room:
                bent[m], pose, now = back, moved, then
        limbs[m] = pose[0]
        after[:, :, :, m] = now[:, :, :, 0]
        most = max(farthest(now, np.ascontiguousarray(person[:, :, :, one]))[0], most)
    return most
