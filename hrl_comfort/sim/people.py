"""People stop where they touch the arm: one who walks on pushes without limit, and the physics goes unstable."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hrl_comfort import humans
from hrl_comfort.safety.separation import Separation
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.signals import limbs_of

OVERLAP_M = 1e-3
"""Depth to which somebody walks into the arm, so that the touch is sensed."""


def stop_at_contact(
    scene: Scene, separation: Separation, angles: NDArray[np.float64], before: humans.Walk, walk: humans.Walk
) -> humans.Walk:
    """Return `walk` with those who would walk into arms at `angles` (n, J) rad held at OVERLAP_M; they may leave.

    `before` and `walk` are the n people before and after a control step.
    """
    gap = separation.gap(angles, limbs_of(scene, walk))
    touched = np.flatnonzero(gap <= 0.0)
    if not len(touched):
        return walk
    stood = before.rows(touched)
    room, gap = separation.gap(angles[touched], limbs_of(scene, stood)), gap[touched]
    share = np.clip((room + OVERLAP_M) / np.maximum(room - gap, 1e-9), 0.0, 1.0)
    stops = np.flatnonzero((gap < room) & (share < 1.0))
    at, stood = touched[stops], stood.rows(stops)
    place = stood.position + share[stops, None] * (walk.position[at] - stood.position)
    return walk.put(at, replace(stood, position=place, velocity=np.zeros_like(stood.velocity)))
