"""Goal postures of a hand, many at once: inverse kinematics by damped Gauss-Newton steps from a library of seeds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.safety.geometry import ArmGeometry
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.variation.grasps import CLOSE_M, CLOSE_RAD, Grasps

Array = NDArray[np.float64]
LIBRARY = 40_000
"""Random postures, of which those that point the hand down seed inverse kinematics."""
DOWNWARD = 0.5
"""Least cosine of the angle between the tools of these and straight down."""
SEEDS = 5
"""Seeds for each orientation of the tool."""
NEAR_M = 0.10
"""Distance of their tools from the goal, once the pan is turned, up to which postures are seeds."""
ITERATIONS = 12
DAMPING = 1e-4
LARGEST_RAD = 0.5
"""Largest step of a joint in one iteration."""
BEND_RAD = 1.0
"""Largest difference of a joint between a posture away from a grasp and the grasp."""
LEAN = 2.0
"""Distance from home, rad, that a rad of the tool's tilt is worth: a hand that stands upright grasps best."""
DISTINCT_RAD = np.radians(25.0)
"""Two postures of a goal differ by this in some joint."""


class GoalPostures:
    """Postures of the arm of `scene` from which its hand grasps or puts down; `grasps` tells which are free."""

    def __init__(self, scene: Scene, grasps: Grasps) -> None:
        self._arm, self._grasps, self._range = ArmGeometry(scene), grasps, scene.joint_range
        low, high = np.clip(scene.joint_range, -np.pi, np.pi).T
        library = np.random.default_rng(0).uniform(low, high, (LIBRARY, len(low)))
        places, turns = self._arm.tool_pose(library)
        down = turns[:, 2, 2] < -DOWNWARD
        self._library, self._places, self._turns = library[down], places[down], turns[down]

    def found(
        self, place: Array, turns: Sequence[Array], home: Array, count: int, back_m: float = 0.0, up_m: float = 0.0
    ) -> Array:
        """Return up to `count` distinct postures (n, J), those near to `home` (J,) and upright first.

        They are `back_m` along the tool and `up_m` from a grasp with the tool at `place` (3,) m and one of `turns`
        (3, 3), to which they lead by a straight way; it and they are free.
        """
        axes = np.stack(turns)
        starts = place - back_m * axes[:, :, 2] + [0.0, 0.0, up_m]
        seeds, which = self._seeds(starts, axes)
        away, reached = self.solve(seeds, starts[which], axes[which])
        away, which = away[reached], which[reached]
        tilt = np.arccos(np.clip(-axes[which, 2, 2], -1.0, 1.0))
        order = np.argsort(np.abs(away - home).max(axis=1) + LEAN * tilt, kind="stable")
        away, which = away[order], which[order]
        at, reached = self.solve(away, np.tile(place, (len(away), 1)), axes[which])
        reached &= (np.abs(at - away) < BEND_RAD).all(axis=1)
        found: list[Array] = []
        for posture, grasp in zip(away[reached], at[reached], strict=True):
            distinct = all(np.abs(posture - other).max() > DISTINCT_RAD for other in found)
            if distinct and self._grasps.free(posture, away=True) and self._grasps.free(grasp):
                found.append(posture)
            if len(found) == count:
                break
        return np.array(found).reshape(-1, len(home))

    def solve(self, joints: Array, places: Array, turns: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return postures (N, J) near `joints` (N, J) with tools at `places` (N, 3) m and axes `turns` (N, 3, 3).

        Return also which (N,) have that pose within the range of the joints. Steps are those of damped least squares
        (Wampler, IEEE Trans. Systems, Man, and Cybernetics 16(1), 1986, 10.1109/TSMC.1986.289285).
        """
        joints = joints.copy()
        if not len(joints):
            return joints, np.zeros(0, dtype=bool)
        for _ in range(ITERATIONS):
            error = self._error(joints, places, turns)
            jacobian = self._jacobian(joints)
            square = jacobian @ jacobian.transpose(0, 2, 1) + DAMPING * np.eye(6)
            step = (jacobian.transpose(0, 2, 1) @ np.linalg.solve(square, error[..., None]))[..., 0]
            joints += np.clip(step, -LARGEST_RAD, LARGEST_RAD)
        error = np.linalg.norm(self._error(joints, places, turns).reshape(-1, 2, 3), axis=2)
        within = ((joints >= self._range[:, 0]) & (joints <= self._range[:, 1])).all(axis=1)
        return joints, (error < [CLOSE_M, CLOSE_RAD]).all(axis=1) & within

    def _error(self, joints: Array, places: Array, turns: Array) -> Array:
        """Return the ways (N, 3) m and rotation vectors (N, 3) rad from the tools to their poses, (N, 6)."""
        at, axes = self._arm.tool_pose(joints)
        off = turns @ axes.transpose(0, 2, 1)
        sine = np.stack([off[:, 2, 1] - off[:, 1, 2], off[:, 0, 2] - off[:, 2, 0], off[:, 1, 0] - off[:, 0, 1]], axis=1)
        cosine = (np.trace(off, axis1=1, axis2=2) - 1) / 2
        size = np.linalg.norm(sine, axis=1) / 2
        angle = np.arctan2(size, cosine)
        return np.concatenate([places - at, sine * (angle / np.maximum(2 * size, 1e-9))[:, None]], axis=1)

    def _jacobian(self, joints: Array) -> Array:
        """Return the Jacobians (N, 6, J) of the tools' poses."""
        pose, at = self._arm.pose(joints), self._arm.tool(joints)
        axes, anchors = pose.axis.transpose(2, 1, 0), pose.anchor.transpose(2, 1, 0)
        moving = np.cross(axes, at[:, None] - anchors)
        return np.concatenate([moving, axes], axis=2).transpose(0, 2, 1)

    def _seeds(self, places: Array, turns: Array) -> tuple[Array, NDArray[np.int64]]:
        """Return postures (n, J) whose tools are about at poses (T, 3) m and (T, 3, 3), and at which (n,) of these."""
        radius, height = np.hypot(self._places[:, 0], self._places[:, 1]), self._places[:, 2]
        seeds, which = list[Array](), list[NDArray[np.int64]]()
        middle = places.mean(axis=0)
        spread = np.linalg.norm(places - middle, axis=1).max() + NEAR_M
        near = np.flatnonzero(np.hypot(radius - np.hypot(*middle[:2]), height - middle[2]) < spread)
        radius, height, axes = radius[near], height[near], self._turns[near]
        bearing = np.arctan2(self._places[near, 1], self._places[near, 0])
        for index, (place, turn) in enumerate(zip(places, turns, strict=True)):
            pan = np.arctan2(place[1], place[0]) - bearing
            cos, sin = np.cos(pan), np.sin(pan)
            turned = np.stack([
                cos[:, None] * axes[:, 0] - sin[:, None] * axes[:, 1],
                sin[:, None] * axes[:, 0] + cos[:, None] * axes[:, 1],
                axes[:, 2],
            ], axis=1)  # fmt: skip
            off = np.arccos(np.clip((np.einsum("nij,ij->n", turned, turn) - 1) / 2, -1.0, 1.0))
            cost = np.hypot(radius - np.hypot(*place[:2]), height - place[2]) + 0.1 * off
            best = np.argsort(cost)[:SEEDS]
            chosen = self._library[near[best]].copy()
            chosen[:, 0] = (chosen[:, 0] + pan[best] + np.pi) % (2 * np.pi) - np.pi
            seeds.append(chosen)
            which.append(np.full(len(best), index))
        return np.concatenate(seeds), np.concatenate(which)
