"""Grasp postures by inverse kinematics (mink): the tool points down, 30 degrees off at most, the pads meet sides."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import mink
import mujoco
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.safety.geometry import ArmGeometry
from hrl_comfort.scene.grippers.cell import GUARD
from hrl_comfort.scene.workcell import Scene

Array = NDArray[np.float64]
TILTS_RAD = np.radians([0.0, 10.0, 20.0, 30.0])
"""Tilts of the tool from straight down, in the order in which they are tried."""
BACK_M = 0.11
"""Distance of the tool from the object before it approaches."""
ABOVE_M = 0.12
"""Height of a lifted object, and of a carried one above its place, over where it lies."""
LIBRARY = 40_000
"""Random postures that seed inverse kinematics."""
TRIED = 6
"""Seeds for each orientation of the tool."""
ITERATIONS = 15
CLOSE_M, CLOSE_RAD = 5e-4, 0.01
"""Errors at which a posture has the pose that is wanted."""
APART_M, CLEAR_M = 0.002, 0.01
"""Smallest distance of arm and fingers from the cell, at a grasp and away from it; away, also of what they hold."""
TIP_CLEARANCE_M = 0.006
"""Distance of the fingertips from what an object lies on."""
COUNT = 48
"""Number of start postures for a goal."""
STARTS_TRIED = 10
"""Tries for each of them."""
AHEAD_RAD = 2.0
"""Largest difference of each joint but the first of a start from home: the arm does not turn its wrist over."""
FACING_RAD = 1.0
"""Largest bearing of the tool of a start from the x axis of the first link: the arm does not bend over backwards."""


def rise_m(scene: Scene, kind: int, size: float = 1.0) -> float:
    """Return how far, m, the tool is above the centre of an object of a kind, `size` times as large, that it grasps."""
    return rise_above_m(scene, size * list(scene.cell.objects.values())[kind].half_height_m)


def rise_above_m(scene: Scene, half_height_m: float) -> float:
    """Return how far, m, the tool is above the centre of an object of half a height that it grasps."""
    assert scene.gripper is not None
    return max(0.0, scene.gripper.tip_m + TIP_CLEARANCE_M - half_height_m)


def narrow_rad(scene: Scene, kind: int) -> float:
    """Return the bearing, rad, in its own frame, in which an object of a kind is narrow."""
    x, y, _ = list(scene.cell.objects.values())[kind].half_m
    return math.pi / 2 if y < x else 0.0


class Grasps:
    """Postures of the arm of `scene` with the tool at a pose."""

    def __init__(self, scene: Scene) -> None:
        self._scene, self._model = scene, mujoco.MjModel.from_xml_string(scene.planning_xml, dict(scene.assets))
        self._guard = self._model.geom(f"robot/{GUARD}").id
        self._model.geom_margin[:] = CLEAR_M
        self._configuration = mink.Configuration(self._model)
        self.data = self._configuration.data
        self._tool = mink.FrameTask("robot/tcp", "site", position_cost=1.0, orientation_cost=0.3, lm_damping=1e-4)
        self._limits = [mink.ConfigurationLimit(self._model)]
        self._arm = ArmGeometry(scene)
        rng = np.random.default_rng(0)
        low, high = np.clip(scene.joint_range, -np.pi, np.pi).T
        self._library = rng.uniform(low, high, (LIBRARY, len(low)))
        self._places, turns = self._arm.tool_pose(self._library)
        self._down, self._across = turns[:, :, 2], turns[:, :, 0]
        aside = np.arctan2(self._places[:, 1], self._places[:, 0]) - self._library[:, 0]
        near = np.abs(self._library[:, 1:] - scene.home[1:]).max(axis=1) < AHEAD_RAD
        self._ahead = np.flatnonzero(near & (np.cos(aside) > math.cos(FACING_RAD)))
        self._furniture = slice(scene.first_furniture, scene.first_prop)

    def stand(self, layout: Array) -> None:
        """Put places and obstacles at their poses (F, 7) in another cell."""
        self.data.mocap_pos[self._furniture] = layout[:, :3]
        self.data.mocap_quat[self._furniture] = layout[:, 3:]

    def pose(self, joints: Array) -> tuple[Array, Array]:
        """Return position (3,) m and axes (3, 3) of the tool at joint angles (J,) rad."""
        self._configuration.update(joints)
        site = self.data.site("robot/tcp")
        return site.xpos.copy(), site.xmat.reshape(3, 3).copy()

    def reach(self, seed: Array, place: Array, turn: Array, iterations: int = ITERATIONS) -> Array | None:
        """Return the posture (J,) near `seed` with the tool at `place` (3,) m and axes `turn` (3, 3), if found."""
        joints = self.towards(seed, place, turn, iterations)
        at, axes = self.pose(joints)
        off = np.arccos(np.clip((np.trace(axes.T @ turn) - 1) / 2, -1.0, 1.0))
        return joints if np.linalg.norm(at - place) < CLOSE_M and off < CLOSE_RAD else None

    def towards(self, seed: Array, place: Array, turn: Array, iterations: int = 1) -> Array:
        """Return joint angles (J,) rad after some iterations from `seed` towards a pose of the tool."""
        self._configuration.update(seed)
        self._tool.set_target(mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(turn), place))
        for _ in range(iterations):
            velocity = mink.solve_ik(self._configuration, [self._tool], 1.0, "daqp", damping=1e-6, limits=self._limits)
            self._configuration.integrate_inplace(velocity, 1.0)
            error = self._tool.compute_error(self._configuration)
            if np.linalg.norm(error[:3]) < CLOSE_M / 5 and np.linalg.norm(error[3:]) < CLOSE_RAD / 5:
                break
        return np.array(self._configuration.q)

    def free(self, joints: Array, away: bool = False) -> bool:
        """Return whether arm and hand keep their distance at joint angles (J,) rad, at a grasp or `away` from it."""
        self.data.qpos[:] = joints
        mujoco.mj_kinematics(self._model, self.data)
        mujoco.mj_collision(self._model, self.data)
        contact = self.data.contact
        if away:
            return not (contact.dist < CLEAR_M).any()
        return not (contact.dist[(contact.geom != self._guard).all(axis=1)] < APART_M).any()

    def seeds(self, place: Array, turn: Array, near: Array, among: NDArray[np.int64] | None = None) -> Array:
        """Return TRIED postures (TRIED, J) near to `near` (J,) whose tool is about at a pose once the pan is turned.

        They are `among` (n,) of the library, by default of all.
        """
        chosen = slice(None) if among is None else among
        library, places, down, across = (
            each[chosen] for each in (self._library, self._places, self._down, self._across)
        )
        pan = np.arctan2(place[1], place[0]) - np.arctan2(places[:, 1], places[:, 0])
        cos, sin = np.cos(pan), np.sin(pan)

        def off(axes: Array, wanted: Array) -> Array:
            x, y = cos * axes[:, 0] - sin * axes[:, 1], sin * axes[:, 0] + cos * axes[:, 1]
            return np.arccos(np.clip(x * wanted[0] + y * wanted[1] + axes[:, 2] * wanted[2], -1, 1))

        away = np.hypot(np.hypot(*places[:, :2].T) - np.hypot(*place[:2]), places[:, 2] - place[2])
        cost = away + 0.15 * off(down, turn[:, 2]) + 0.05 * off(across, turn[:, 0])
        cost += 0.02 * np.abs(library[:, 1:] - near[1:]).max(axis=1)
        best = np.argpartition(cost, TRIED)[:TRIED]
        best = best[np.argsort(cost[best])]
        seeds = library[best].copy()
        seeds[:, 0] = (seeds[:, 0] + pan[best] + np.pi) % (2 * np.pi) - np.pi
        return seeds

    def found(
        self, place: Array, turns: Iterable[Array], near: Array, count: int, back_m: float = 0.0, up_m: float = 0.0
    ) -> list[Array]:
        """Return up to `count` postures (J,), `back_m` along the tool and `up_m` from a grasp, and near to `near` (J,).

        A grasp has the tool at `place` (3,) m with one of `turns` (3, 3); it and the posture are free.
        """
        found: list[Array] = []
        for turn in turns:
            away = self._first(place - back_m * turn[:, 2] + [0.0, 0.0, up_m], place, turn, near)
            if away is not None:
                found.append(away)
            if len(found) == count:
                break
        return found

    def _first(
        self, start: Array, place: Array, turn: Array, near: Array, among: NDArray[np.int64] | None = None
    ) -> Array | None:
        """Return the first posture (J,) of `_leading` from `seeds` near to `near` (J,)."""
        ways = (self._leading(seed, start, place, turn) for seed in self.seeds(start, turn, near, among))
        return next((each for each in ways if each is not None), None)

    def _leading(self, seed: Array, start: Array, place: Array, turn: Array) -> Array | None:
        """Return the posture (J,) near `seed` with the tool at `start` (3,) m, if it and the grasp are free.

        The tool has axes `turn` (3, 3) there, and in the grasp at `place` (3,) m.
        """
        away = self.reach(seed, start, turn)
        if away is None or not self.free(away, away=True):
            return None
        at = self.reach(away, place, turn)
        return away if at is not None and self.free(at) and np.abs(at - away).max() < 1.0 else None

    def moved(self, postures: Array, origin: Array, place: Array, lifted: bool, count: int) -> Array:
        """Return up to `count` postures (n, J) as `starts` at `place` (3,) m, from those (m, J) at `origin` (3,) m.

        Hands keep their pose at the object but for the bearing from the robot.
        """
        pan, found = math.atan2(place[1], place[0]) - math.atan2(origin[1], origin[0]), list[Array]()
        cos, sin = math.cos(pan), math.sin(pan)
        spin = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        for posture in postures:
            at, axes = self.pose(posture)
            start, turn, seed = place + spin @ (at - origin), spin @ axes, posture.copy()
            seed[0] = (seed[0] + pan + np.pi) % (2 * np.pi) - np.pi
            way = np.array([0.0, 0.0, 1.0]) if lifted else turn[:, 2] / turn[2, 2]
            away = self._leading(seed, start, start + (place[2] - start[2]) * way, turn)
            if away is not None:
                found.append(away)
            if len(found) == count:
                break
        return np.array(found).reshape(-1, postures.shape[1])

    def starts(self, place: Array, lifted: bool, spread_m: float = 0.0, count: int = COUNT) -> Array:
        """Return up to `count` postures (n, J) of a hand that has `lifted` an object from (3,) m, or is in front of it.

        The object is up to `spread_m` away along x and y. An arm gets there from home.
        """
        rng, found, home = np.random.default_rng(0), list[Array](), self._scene.home
        for _ in range(STARTS_TRIED * count):
            tilt, azimuth, up = rng.choice(TILTS_RAD), rng.uniform(-np.pi, np.pi), rng.uniform(0.9, 1.2)
            back_m, up_m = (0.0, up * ABOVE_M) if lifted else (up * BACK_M, 0.0)
            at = place + np.array([*rng.uniform(-spread_m, spread_m, 2), 0.0])
            turn = turn_of(float(tilt), azimuth, float(rng.choice([-1.0, 1.0])))
            start = at - back_m * turn[:, 2] + [0.0, 0.0, up_m]
            away = self._first(start, at, turn, home, self._ahead)
            if away is not None and np.abs(away[1:] - home[1:]).max() < AHEAD_RAD:
                found.append(away)
            if len(found) == count:
                break
        return np.array(found).reshape(-1, len(home))


def turn_of(tilt: float, azimuth: float, side: float) -> Array:
    """Return the axes (3, 3) of a tool that points down, `tilt` rad off towards `azimuth` rad; `side` is 1 or -1."""
    down = np.array([math.sin(tilt) * math.cos(azimuth), math.sin(tilt) * math.sin(azimuth), -math.cos(tilt)])
    across = side * np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    return np.stack([across, np.cross(down, across), down], axis=1)


def approaches(place: Array, yaw: float | None = None, between: float = math.pi / 2) -> Iterator[Array]:
    """Yield axes (3, 3) of tools for an object at (3,) m: nearly straight down and leaning outwards first.

    From pad to pad they point to a side at bearing `yaw` rad, or to one `between` rad from there on; None: to any.
    """
    outwards = math.atan2(place[1], place[0])
    if yaw is None:
        bearings = outwards + np.arange(8) * np.pi / 4
    else:  # a tool leans across the line from pad to pad
        bearings = yaw + math.pi / 2 + np.arange(0.0, 2 * np.pi - 1e-9, between)
    order = np.argsort(np.abs(np.angle(np.exp(1j * (bearings - outwards)))), kind="stable")
    for tilt in TILTS_RAD:
        for azimuth in bearings[order]:
            for side in (1.0, -1.0):
                yield turn_of(float(tilt), float(azimuth), side)
