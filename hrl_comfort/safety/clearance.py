"""Clearance: set-points brake in time before places, obstacles, the pedestal, the floor and the arm's own links.

Where the arm would come to rest if it ran a commanded velocity for a control step and braked then, no capsule may be
nearer than the clearance to something, unless it is no nearer than it is now. Braking goes on along the same way, so
what was allowed once stays allowed. Places and obstacles count as solid from their tops down.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import contiguous, plain
from hrl_comfort.config import FAR_AWAY_M
from hrl_comfort.safety import clearance_kernels as kernels
from hrl_comfort.safety.clearance_kernels import CLOSER_M
from hrl_comfort.safety.geometry import ArmGeometry, ArmPose, closest_points, cross, dot, norm
from hrl_comfort.scene.furniture import STANDS
from hrl_comfort.scene.workcell import Scene

Array = NDArray[np.float64]
SPACING_M = 0.04
"""Largest distance between the points along a capsule from which distances are measured: they are 4 mm too large at
most."""


DAMPING_S, REACH_M, ROUNDS = 0.1, 0.1, 4
"""Time in which an approach at a damped speed would use up the room that is left; the room within which it is damped;
constraints that are met in turn."""


class Clearance:
    """Check and damper that keep N arms `clearance_m` away from what stands there, and from themselves."""

    def __init__(self, scene: Scene, arm: ArmGeometry, clearance_m: float) -> None:
        self._arm, self._clearance_m = arm, clearance_m
        lengths = np.linalg.norm(arm.local[:, 1] - arm.local[:, 0], axis=1)
        counts = np.where(lengths > 0, np.ceil(lengths / SPACING_M), 0).astype(int) + 1
        self._capsules = np.repeat(np.arange(len(counts)), counts)
        self._shares = np.concatenate([np.linspace(0.0, 1.0, count) for count in counts])
        self._pairs = np.array(_pairs(scene.planning, arm), dtype=np.int64).reshape(-1, 2)
        self._posts, self._floor_z = _posts(scene.planning), scene.floor_z
        around = self._capsules, self._shares, self._pairs, self._posts, self._floor_z
        self._compiled = arm.compiled, arm.radius, around, clearance_m

    def keeps(self, begin: Array, end: Array, tops: Array) -> NDArray[np.bool_]:
        """Return (N,) whether arms that go from `begin` to `end` (N, J) rad keep clear, or come no nearer.

        `tops` (N, F, 6) as in `State.tops`.
        """
        if plain(begin, end, tops):
            return kernels.keeps(*contiguous(begin, end, tops), *self._compiled)
        here, there = (self._vectors(self._arm.pose(angles), tops) for angles in (begin, end))
        clear: Any = (there.room >= 0.0) | (there.gap >= here.gap - CLOSER_M)
        kept: NDArray[np.bool_] = clear.all(axis=0)
        return kept

    def damped(self, angles: Array, asked: Array, tops: Array) -> Array:
        """Return `asked` (N, J) rad/s slowed towards what is near, so that arms at `angles` (N, J) rad slide along it.

        A velocity damper (Faverjon and Tournassoud 1987, section 3): no point comes nearer faster than its room would
        last for `DAMPING_S`. The constraint that is broken most is met by the least change, `ROUNDS` times.
        """
        if plain(angles, asked, tops):
            given = contiguous(angles, asked, tops)
            return kernels.damped(*given, *self._compiled, DAMPING_S, REACH_M, ROUNDS)
        pose = self._arm.pose(angles)
        near = self._vectors(pose, tops)
        rates = near.rates(pose)
        limit = np.where(near.room < REACH_M, np.maximum(near.room, 0.0) / DAMPING_S, FAR_AWAY_M / DAMPING_S)
        for _ in range(ROUNDS):
            slack = limit + sum(rates[j] * asked[:, j] for j in range(self._arm.joints))
            worst = slack.argmin(axis=0)[None]
            over = np.minimum(np.take_along_axis(slack, worst, axis=0)[0], 0.0)
            row = [np.take_along_axis(rate, worst, axis=0)[0] for rate in rates]
            square = np.maximum(sum(each * each for each in row), 1e-9)
            asked = np.stack([asked[:, j] - each * (over / square) for j, each in enumerate(row)], axis=1)
        return asked

    def _vectors(self, pose: ArmPose, tops: Array) -> _Near:
        """Return what each point of arms at `pose`, and each pair of capsules, is near to."""
        ends, capsules = pose.ends, self._capsules
        first, last = ends[:, capsules, 0], ends[:, capsules, 1]
        points, links = first + (last - first) * self._shares[:, None], self._arm.link[capsules]
        thick = np.tile(self._arm.radius[capsules], tops.shape[1] + len(self._posts) + 1)
        found = []
        for index in range(tops.shape[1]):
            x, y, z, half_x, half_y, turn = tops[:, index].T
            cos, sin = np.cos(turn), np.sin(turn)
            u, v = points[0] - x, points[1] - y
            u, v = cos * u + sin * v, cos * v - sin * u
            u, v = u - np.minimum(np.maximum(u, -half_x), half_x), v - np.minimum(np.maximum(v, -half_y), half_y)
            found.append(np.stack([cos * u - sin * v, sin * u + cos * v, np.maximum(points[2] - z, 0.0)]))
        for radius, top, link in self._posts:
            outside = np.sqrt(points[0] * points[0] + points[1] * points[1])
            share = np.maximum(1 - radius / np.maximum(outside, 1e-9), 0.0)
            beside = np.stack([points[0] * share, points[1] * share, np.maximum(points[2] - top, 0.0)])
            found.append(np.where((links >= link)[:, None], beside, FAR_AWAY_M))
        flat = 0.0 * points[2]
        found.append(np.stack([flat, flat, np.maximum(points[2] - self._floor_z, 0.0)]))
        a, b = self._pairs.T
        on_a, on_b = closest_points(ends[:, a, 0], ends[:, a, 1], ends[:, b, 0], ends[:, b, 1])
        vectors = np.concatenate([*found, on_a - on_b], axis=1)
        thick = np.concatenate([thick, self._arm.radius[a] + self._arm.radius[b]])
        copies = len(found)
        moving = np.concatenate([np.concatenate([points] * copies, axis=1), on_a], axis=1)
        link = np.concatenate([np.tile(links, copies), self._arm.link[a]])
        return _Near(vectors, thick[:, None] + self._clearance_m, moving, link, on_b, self._arm.link[b])


class _Near:
    """R points of arms, and what each of them is nearest to.

    `vectors` (3, R, N) m lead from there to the `points`, `near` (R, 1) m are the least distances to keep. The last
    points are those on one capsule nearest to the `others` (3, Q, N) of a second one. `link` (R,) and `other_link` (Q,)
    move them.
    """

    def __init__(
        self, vectors: Array, near: Array, points: Array, link: NDArray[np.int64], others: Array,
        other_link: NDArray[np.int64],
    ) -> None:  # fmt: skip
        self._vectors, self._points, self._link, self._others, self._other_link = (
            vectors, points, link, others, other_link,
        )  # fmt: skip
        self.gap = norm(vectors)
        """(R, N) m."""
        self.room = self.gap - near
        """(R, N) m, what is left."""

    def rates(self, pose: ArmPose) -> list[Array]:
        """Return for each joint how fast (R, N) m the gaps grow with its velocity."""
        inside = self.gap <= 0.0
        unit = self._vectors / np.where(inside, 1.0, self.gap)
        way = np.stack([unit[0], unit[1], np.where(inside, 1.0, unit[2])])
        found, pairs = [], len(self._other_link)
        for j in range(pose.axis.shape[1]):
            axis, anchor = pose.axis[:, j, None], pose.anchor[:, j, None]
            rate = np.where((self._link >= j)[:, None], dot(way, cross(axis, self._points - anchor)), 0.0)
            back = np.where(
                (self._other_link >= j)[:, None], dot(way[:, -pairs:], cross(axis, self._others - anchor)), 0.0
            )
            found.append(np.concatenate([rate[:-pairs], rate[-pairs:] - back]))
        return found


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
