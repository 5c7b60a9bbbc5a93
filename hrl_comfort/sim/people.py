"""People stop where they touch the arm, and step back.

One who walks on pushes without limit, and the physics goes unstable; one who stays stands in the arm's way for ever.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hrl_comfort import humans
from hrl_comfort.humans.retreat import begin_retreat
from hrl_comfort.safety.geometry import farthest, gaps
from hrl_comfort.safety.separation import Encounter, Separation
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.controls import limbs_of

OVERLAP_M = 1e-5
"""Depth to which somebody walks into the arm, so that the touch is sensed. People are moved, and push without limit:
from a depth of 1 mm they flung parts that cannot give way at 5 m/s."""


def share_walked(room: NDArray[np.float64], gap: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the share (n,) of a step that ends at OVERLAP_M, 1 if it is free.

    It begins at `room` (n,) m from the arm and would end at `gap` (n,) m from it.
    """
    share = np.clip((room + OVERLAP_M) / np.maximum(room - gap, 1e-9), 0.0, 1.0)
    return np.where(gap < room, share, 1.0)


def stop_at_contact(
    scene: Scene, separation: Separation, now: Encounter, before: humans.Walk, walk: humans.Walk
) -> tuple[humans.Walk, NDArray[np.float64]]:
    """Return `walk` with those who would walk into the arms held at OVERLAP_M, who will leave.

    Return their limbs (n, L, 7), too. `before` and `walk` are the n people before and after a control step, `now` the
    arms beside the people before it.
    """
    limbs = limbs_of(scene, walk)
    person = separation.person.ends(limbs)
    room, moved = now.apart.min(axis=0), farthest(person, now.person)
    near = np.flatnonzero(room <= moved)
    gap = gaps(separation.arm, now.pose.ends[..., near], separation.person, person[..., near]).min(axis=0)
    touched, gap = near[gap <= 0.0], gap[gap <= 0.0]
    if not len(touched):
        return walk, limbs
    walk = begin_retreat(walk, touched)
    stood = before.rows(touched)
    share = share_walked(room[touched], gap)
    stops = np.flatnonzero(share < 1.0)
    at, stood = touched[stops], stood.rows(stops)
    place = stood.position + share[stops, None] * (walk.position[at] - stood.position)
    held = replace(stood, position=place, velocity=np.zeros_like(stood.velocity), retreat=walk.retreat[at])
    limbs[at] = limbs_of(scene, held)
    return walk.put(at, held), limbs
