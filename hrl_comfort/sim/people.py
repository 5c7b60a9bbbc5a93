"""People stop where they touch the arm, and step back.

One who walks on pushes without limit, and the physics goes unstable; one who stays stands in the arm's way for ever.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hrl_comfort import humans
from hrl_comfort.humans.retreat import begin_retreat
from hrl_comfort.safety.separation import Separation
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.signals import limbs_of

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
    scene: Scene, separation: Separation, angles: NDArray[np.float64], before: humans.Walk, walk: humans.Walk
) -> humans.Walk:
    """Return `walk` with those who would walk into arms at `angles` (n, J) rad held at OVERLAP_M; they will leave.

    `before` and `walk` are the n people before and after a control step.
    """
    gap = separation.gap(angles, limbs_of(scene, walk))
    touched = np.flatnonzero(gap <= 0.0)
    if not len(touched):
        return walk
    walk = begin_retreat(walk, touched)
    stood = before.rows(touched)
    room, gap = separation.gap(angles[touched], limbs_of(scene, stood)), gap[touched]
    share = share_walked(room, gap)
    stops = np.flatnonzero(share < 1.0)
    at, stood = touched[stops], stood.rows(stops)
    place = stood.position + share[stops, None] * (walk.position[at] - stood.position)
    held = replace(stood, position=place, velocity=np.zeros_like(stood.velocity), retreat=walk.retreat[at])
    return walk.put(at, held)
