"""Clearance: set-points brake in time before places, obstacles, the pedestal, the floor and the arm's own links.

Where the arm would come to rest if it ran a commanded velocity for a control step and braked then, no capsule may be
nearer than the clearance to something, unless it is no nearer than it is now. Braking goes on along the same way, so
what was allowed once stays allowed. Places and obstacles count as solid from their tops down.
"""

from __future__ import annotations

from itertools import combinations, pairwise
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import contiguous, plain
from hrl_comfort.safety import clearance_kernels as kernels
from hrl_comfort.safety.clearance_kernels import CLOSER_M
from hrl_comfort.safety.geometry import ArmGeometry, norm, segment_distance
from hrl_comfort.scene.furniture import STANDS
from hrl_comfort.scene.workcell import Scene

Array = NDArray[np.float64]
SPACING_M = 0.04
"""Largest distance between the points along a capsule from which distances are measured: they are 4 mm too large at
most."""


class Clearance:
    """Which of N arms would come nearer than `clearance_m` to what stands there, or to themselves."""

    def __init__(self, scene: Scene, arm: ArmGeometry, clearance_m: float) -> None:
        self._arm, self._clearance_m = arm, clearance_m
        lengths = np.linalg.norm(arm.local[:, 1] - arm.local[:, 0], axis=1)
        counts = np.where(lengths > 0, np.ceil(lengths / SPACING_M), 0).astype(int) + 1
        self._begins = np.concatenate([[0], np.cumsum(counts)])
        """(C + 1,) index of the first point of each capsule, and the number of points."""
        self._along = np.concatenate([np.linspace(0.0, 1.0, count) for count in counts])
        self._pairs = np.array(_pairs(scene.planning, arm), dtype=np.int64).reshape(-1, 2)
        self._posts, self._floor_z = _posts(scene.planning), scene.floor_z

    def keeps(self, begin: Array, end: Array, tops: Array) -> NDArray[np.bool_]:
        """Return (N,) whether arms that go from `begin` to `end` (N, J) rad keep clear, or come no nearer.

        `tops` (N, F, 6) as in `State.tops`.
        """
        if plain(begin, end, tops):
            given = contiguous(begin, end, tops)
            fixed = self._begins, self._along, self._pairs, self._posts, self._floor_z, self._clearance_m
            return kernels.keeps(*given, self._arm.compiled, self._arm.radius, *fixed)
        here, there = (self._distances(self._arm.pose(angles).ends, tops) for angles in (begin, end))
        clear: Any = (there >= self._clearance_m) | (there >= here - CLOSER_M)
        kept: NDArray[np.bool_] = clear.all(axis=0)
        return kept

    def _distances(self, ends: Array, tops: Array) -> Array:
        """Return the distances (R, N) m of arms with capsules' `ends` (3, C, 2, N) from all that they may meet."""
        part = np.repeat(np.arange(len(self._begins) - 1), np.diff(self._begins))
        first, last = ends[:, part, 0], ends[:, part, 1]
        points = first + (last - first) * self._along[:, None]
        found = []
        for index in range(tops.shape[1]):
            x, y, z, half_x, half_y, turn = tops[:, index].T
            away = points[0] - x, points[1] - y
            cos, sin = np.cos(turn), np.sin(turn)
            over = np.maximum(np.abs(cos * away[0] + sin * away[1]) - half_x, 0.0)
            aside = np.maximum(np.abs(cos * away[1] - sin * away[0]) - half_y, 0.0)
            found.append(self._of_parts(norm(np.stack([over, aside, np.maximum(points[2] - z, 0.0)]))))
        for radius, top, link in self._posts:
            beside = np.maximum(np.sqrt(points[0] * points[0] + points[1] * points[1]) - radius, 0.0)
            above = np.maximum(points[2] - top, 0.0)
            apart = self._of_parts(np.sqrt(beside * beside + above * above))
            found.append(np.where((self._arm.link >= link)[:, None], apart, np.inf))
        found.append(self._of_parts(points[2] - self._floor_z))
        a, b = self._pairs.T
        apart = segment_distance(ends[:, a, 0], ends[:, a, 1], ends[:, b, 0], ends[:, b, 1])
        found.append(apart - (self._arm.radius[a] + self._arm.radius[b])[:, None])
        return np.concatenate(found)

    def _of_parts(self, distances: Array) -> Array:
        """Return the distances (C, N) m of capsules from those (P, N) of points on their axes."""
        nearest = [distances[at:to].min(axis=0) for at, to in pairwise(self._begins)]
        return np.stack(nearest) - self._arm.radius[:, None]


def _posts(model: mujoco.MjModel) -> Array:
    """Return radius and top, m, of the pedestal and of the robot's base, and the first link that may meet it."""
    base, pedestal = model.geom("robot/base"), model.geom(STANDS[0])
    top = base.pos[2] + model.body("robot/base").pos[2] + base.size[1] + base.size[0]
    return np.array([[pedestal.size[0], pedestal.pos[2] + pedestal.size[1], 1], [base.size[0], top, 2]])


def _pairs(model: mujoco.MjModel, arm: ArmGeometry) -> list[tuple[int, int]]:
    """Return the pairs of capsules of an arm that may meet: of links that are no neighbours, and are not excluded."""
    excluded = set()
    links = {int(body): link for link, body in enumerate(arm.bodies)}
    for signature in model.exclude_signature.tolist():
        pair = [links.get(body, -1) for body in (signature >> 16, signature & 0xFFFF)]
        excluded.add((min(pair), max(pair)))
    found = []
    for first, second in combinations(range(len(arm.link)), 2):
        low, high = sorted((int(arm.link[first]), int(arm.link[second])))
        if high - low > 1 and (low, high) not in excluded:
            found.append((first, second))
    return found
