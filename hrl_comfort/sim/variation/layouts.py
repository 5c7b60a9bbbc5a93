"""Layouts of a cell: the one given, or those that `cell.vary` draws for each split.

A layout is known by its split and its number, so that recorded starts can name the one they belong to.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import FAR_AWAY_M, CellConfig, ConfigError, EnvConfig, VaryConfig
from hrl_comfort.config.cell import DIGITS
from hrl_comfort.scene.furniture import THICKNESS_M, turn
from hrl_comfort.scene.layout import reach
from hrl_comfort.scene.workcell import Scene, tool_at
from hrl_comfort.sim.variation.grasps import COUNT as GRASPS
from hrl_comfort.sim.variation.grasps import Grasps, rise_m
from hrl_comfort.sim.variation.postures import Postures
from hrl_comfort.sim.variation.random_streams import random_stream
from hrl_comfort.tasks import Start

Array = NDArray[np.float64]
BEHIND_M = 0.4
"""Distance of people's stations behind the places."""
ATTEMPTS, TRIES = 300, 12
"""Draws of a layout before it is given up, and of a posture for one of its goals."""
POSTURES = 4
"""Largest number of postures for each goal of a layout that is drawn."""
REACHED = 0.92
"""Part of the arm's reach within which goals are drawn."""
SERVED_M = 0.04
"""Distance to everything that stands there with which the arm can serve a layout that is drawn."""
COUNT = 96
"""Number of postures for each goal of a cell that does not vary."""
MODELS = 12
"""Number of postures of a hand in the layout given from which those in layouts that are drawn are made."""
ROUNDED = 1e-9
"""Rounding of coordinates, m."""
SPLITS = ("train", "validation", "test")


@dataclass(frozen=True)
class Layout:
    """Poses of everything that stands in an episode; metres, cell frame."""

    number: float
    """Of the layout in its split; NaN of the only one of a cell that does not vary."""
    places: Array
    """(M, 7) m and quaternion, poses of the middle of the tops of the places."""
    obstacles: Array
    """(O, 7) m and quaternion, poses of the obstacles; one that is not there is far away."""
    tops: Array
    """(F, 6), tops of places and obstacles, as `State.tops`."""
    goals: Array
    """(M, 3) m, goal of the tool at each place."""
    arrives: Array
    """(kinds, 3) m, centre of an object of each kind in the middle of the place where it arrives."""
    belongs: Array
    """(kinds, 3) m, centre of an object of each kind where it belongs."""
    stations: Array
    """(S, 2) m, where people work."""
    home: Array
    """(J,) rad."""
    tcp_home: Array
    """(3,) m, tool centre point with every joint at home."""
    at_arrival: list[Array]
    at_place: list[Array]
    """Of each kind, postures (n, J) rad with the tool at the goal where it arrives, and where it belongs."""

    def yaw(self, index: int) -> float:
        """Return the turn of a place about the vertical, rad."""
        w, _, _, z = self.places[index, 3:]
        return 2 * float(np.arctan2(z, w))


class Layouts:
    """Layouts of the cell of `scene`.

    Raises:
      ConfigError: no layout within the ranges of `cell.vary` can be reached.
    """

    def __init__(self, scene: Scene, config: EnvConfig) -> None:
        self._scene, self._cell, self._precision = scene, config.cell, config.task.precision
        self._jitter = config.task.object_jitter_m
        self._shoulder, self._reach = reach(config.robot.name, config.robot.end_effector, config.robot.gripper)
        self._solver = Postures(scene.planning_xml, scene.home, SERVED_M)
        self._known: dict[tuple[str, int], Layout] = {}
        self._hand_postures: dict[tuple[bytes, Start, int], Array] = {}
        self._hand = scene.gripper is not None

    @property
    def varies(self) -> bool:
        """Whether the layout differs from one episode to another."""
        return self._cell.vary.layouts > 0

    @cached_property
    def given(self) -> Layout:
        """The layout of the configuration."""
        places, obstacles = np.split(self._scene.layout, [len(self._cell.places)])
        return self._layout(np.nan, places, obstacles, self._scene.home)

    def postures(self, layout: Layout, start: Start, kind: int) -> Array:
        """Return postures (n, J) rad with the tool where `start` says, for an object of a kind."""
        if self._hand:
            return self._of_hand(layout, start, kind)
        picked = start == Start.AT_OBJECT
        if layout is not self.given:
            return (layout.at_arrival if picked else layout.at_place)[kind]
        goal = (layout.arrives if picked else layout.belongs)[kind]
        near = self._precision.grasp_tolerance_m if picked else self._precision.place_tolerance_m
        return inverse_kinematics(
            self._scene.planning_xml, tuple(goal.tolist()), near, tuple(self._scene.home.tolist())
        )

    def _of_hand(self, layout: Layout, start: Start, kind: int) -> Array:
        """Return postures (n, J) rad of a hand in front of an object of a kind, or that has lifted it or let it go."""
        goal = self._goal(layout, start, kind)
        poses = np.concatenate([layout.places, layout.obstacles])
        key = (poses.tobytes(), start, kind)
        if key not in self._hand_postures and layout is not self.given:
            self._hand_postures[key] = self._moved(layout, start, kind, goal, POSTURES)
        elif key not in self._hand_postures:
            self._grasps.stand(poses)
            spread, count = self._jitter if start == Start.BEFORE_OBJECT else 0.0, MODELS if self.varies else GRASPS
            point = goal + self._rise(kind)
            self._hand_postures[key] = self._grasps.starts(point, start == Start.AT_OBJECT, spread, count)
        if not len(self._hand_postures[key]):
            raise ConfigError(f"no grasp found at cell point {goal.round(3).tolist()}: is it within reach?")
        return self._hand_postures[key]

    def _goal(self, layout: Layout, start: Start, kind: int) -> Array:
        """Return the centre (3,) m of an object of a kind at which a hand begins."""
        return np.asarray((layout.belongs if start == Start.AT_PLACE else layout.arrives)[kind])

    def _rise(self, kind: int) -> Array:
        return np.array([0.0, 0.0, rise_m(self._scene, kind)])

    def _moved(self, layout: Layout, start: Start, kind: int, goal: Array, count: int) -> Array:
        """Return up to `count` postures (n, J) rad as `_of_hand`, of an object at `goal` (3,) m in a layout drawn."""
        models, origin = self._of_hand(self.given, start, kind), self._goal(self.given, start, kind)
        models = np.roll(models, -POSTURES * int(layout.number), axis=0)  # others in the next layout
        self._grasps.stand(np.concatenate([layout.places, layout.obstacles]))
        rise = self._rise(kind)
        return self._grasps.moved(models, origin + rise, goal + rise, start == Start.AT_OBJECT, count)

    def _served(self, layout: Layout) -> bool:
        """Return whether a hand can lift an object of each kind where it arrives and where it belongs."""
        ends = {
            goal.tobytes(): (kind, goal) for each in (layout.arrives, layout.belongs) for kind, goal in enumerate(each)
        }
        return all(len(self._moved(layout, Start.AT_OBJECT, *end, 1)) for end in ends.values())

    @cached_property
    def _grasps(self) -> Grasps:
        return Grasps(self._scene)

    def numbered(self, split: str, number: int) -> Layout:
        """Return the layout `number` of `cell.vary` in a split, one of SPLITS."""
        if (split, number) in self._known:
            return self._known[split, number]
        vary = self._cell.vary
        if vary.height_m[1] < self._lowest_m:
            raise ConfigError(
                f"cell.vary.height_m={vary.height_m} is below the table that carries the places; let it end at "
                f"{self._lowest_m:g} or higher"
            )
        rng = random_stream(SPLITS.index(split), number)
        for _ in range(ATTEMPTS):
            found = self._drawn(vary, number, rng)
            if found is not None:
                self._known[split, number] = found
                return found
        raise ConfigError(
            f"cell.vary: none of {ATTEMPTS} layouts can be reached; bring cell.vary.distance_m={vary.distance_m} and "
            f"cell.vary.height_m={vary.height_m} nearer to the arm, or lower cell.vary.apart_m={vary.apart_m:g}"
        )

    def _drawn(self, vary: VaryConfig, number: int, rng: np.random.Generator) -> Layout | None:
        """Return a layout that the arm can serve SERVED_M away from everything, if this draw is one.

        At each goal there is a posture from which it can rise straight to home, turn there and come down elsewhere;
        with a gripper one that has lifted an object.
        """
        count, standing = len(self._cell.places), len(self._cell.obstacles)
        ground = self._ground(vary, count + standing, rng)
        places, obstacles = (each.copy() for each in np.split(self._scene.layout, [count]))
        low, high = vary.height_m
        height = rng.uniform(low, high, count).round(DIGITS)
        there = rng.random(standing) < vary.obstacle_probability
        home = self._scene.home + np.radians(vary.home_deg) * rng.uniform(-1, 1, len(self._scene.home))
        if ground is None or height.min() < self._lowest_m - ROUNDED:
            return None
        places[:, :2], places[:, 2] = ground[:count], height
        stays = np.arange(count, count + standing)[:, None] == self._table
        obstacles[:, :2] = np.where(
            stays, obstacles[:, :2], np.where(there[:, None], ground[count:], [FAR_AWAY_M, 0.0])
        )
        for pose, place in zip(places, self._cell.places.values(), strict=True):
            pose[3:] = turn(float(np.arctan2(pose[1], pose[0]) + np.radians(place.yaw_deg)))
        found = self._layout(number, places, obstacles, home)
        ends = [*found.arrives, *found.belongs]
        if max(np.linalg.norm(end - self._shoulder) for end in ends) > REACHED * self._reach:
            return None
        self._solver.stand(home, np.concatenate([places, obstacles]), self._scene.first_furniture)
        if not self._solver.free(home) or not self._solver.turns():
            return None
        if self._hand:
            return found if self._served(found) else None
        near = self._precision.grasp_tolerance_m, self._precision.place_tolerance_m
        solved: dict[bytes, Array] = {}
        every = (found.arrives, found.belongs), near, (found.at_arrival, found.at_place)
        for goals, tolerance, postures in zip(*every, strict=True):
            for goal in goals:
                if goal.tobytes() not in solved:
                    solved[goal.tobytes()] = self._solver.solve(goal, tolerance, POSTURES, TRIES, rng, rising=True)
                if not len(solved[goal.tobytes()]):
                    return None
                postures.append(solved[goal.tobytes()])
        return found

    def _ground(self, vary: VaryConfig, count: int, rng: np.random.Generator) -> Array | None:
        """Return where (count, 2) m things stand, `apart_m` from each other, on their table, if this draw is free."""
        found: list[Array] = []
        for index in range(count):
            if index == self._table:
                found.append(np.full(2, np.inf))
                continue
            for _ in range(1 if self._table is None else ATTEMPTS):
                near, far = vary.distance_m
                distance, bearing = rng.uniform(near, far), rng.uniform(-np.pi, np.pi)
                place = distance * np.array([np.cos(bearing), np.sin(bearing)])
                apart = all(np.linalg.norm(place - other) >= vary.apart_m for other in found)
                if apart and (self._table is None or self._upon(self._table, index, place)):
                    found.append(place)
                    break
            else:
                return None
        return np.array(found)

    @cached_property
    def _lowest_m(self) -> float:
        """Smallest height of a place's top, m: on the table, where one carries the places."""
        return -np.inf if self._table is None else float(self.given.tops[self._table, 2] + THICKNESS_M)

    @cached_property
    def _table(self) -> int | None:
        """Number in the layout of the box that carries every place in the configuration, if one does: it stays."""
        places, standing = list(self._cell.places.values()), list(self._cell.obstacles.values())
        tops, lowest = self.given.tops, min(each.top_m[2] for each in places) - THICKNESS_M
        carried = not any(each.legs for each in places)
        for table, each in enumerate(standing, len(places)):
            under = each.shape == "box" and tops[table, 2] <= lowest + ROUNDED
            if carried and under and all(inside(tops[index], tops[table]) for index in range(len(places))):
                return table
        return None

    def _upon(self, table: int, index: int, at: Array) -> bool:
        """Return whether a thing of the layout is on the table where it stands at (2,) m, turned as it is drawn."""
        top = self.given.tops[index].copy()
        top[:2] = at
        if index < len(self._cell.places):
            yaw_deg = list(self._cell.places.values())[index].yaw_deg
            top[5] = np.arctan2(at[1], at[0]) + np.radians(yaw_deg)
        return inside(top, self.given.tops[table])

    def _layout(self, number: float, places: Array, obstacles: Array, home: Array) -> Layout:
        cell, names = self._cell, list(self._cell.places)
        goals = np.array(
            [[*pose[:2], round(pose[2] + up, DIGITS)] for pose, up in zip(places, rises(cell), strict=True)]
        )

        def centres(end: str) -> Array:
            tops = [(places[names.index(getattr(each, end))], each.half_height_m) for each in cell.objects.values()]
            return np.array([[*pose[:2], round(pose[2] + up, DIGITS)] for pose, up in tops])

        stations = np.array(cell.stations_m) if cell.stations_m is not None else behind(places[:, :2])
        if self.varies and np.isfinite(number):
            stations = behind(places[:, :2])
        ends = centres("arrives_at"), centres("belongs_at")
        surfaces, tcp_home = tops(cell, places, obstacles), tool_at(self._scene, home)
        return Layout(number, places, obstacles, surfaces, goals, *ends, stations, home, tcp_home, [], [])


@lru_cache(maxsize=32)
def inverse_kinematics(xml: str, goal: tuple[float, ...], precision_m: float, home: tuple[float, ...]) -> Array:
    """Return (COUNT, J) rad: postures free of contact with the tool within `precision_m` of `goal`; see `Postures`.

    Raises:
      ConfigError: there are fewer.
    """
    rng = np.random.default_rng(0)
    found = Postures(xml, np.array(home)).solve(np.array(goal), precision_m, COUNT, 50 * COUNT, rng)
    if len(found) < COUNT:
        raise ConfigError(f"only {len(found)} of {COUNT} starts found at cell point {goal}: is it within reach?")
    return found


def rises(cell: CellConfig) -> list[float]:
    """Return how high (M,) m above the top of each place the goal of the tool is; see `CellConfig.goals`."""
    return [goal[2] - place.top_m[2] for goal, place in zip(cell.goals.values(), cell.places.values(), strict=True)]


def tops(cell: CellConfig, places: Array, obstacles: Array) -> Array:
    """Return the tops (F, 6) of places and obstacles at poses (M, 7), (O, 7): middle, half sides m, turn rad."""
    half = [np.array(each.size_m) / 2 for each in cell.places.values()]
    half += [
        np.array(each.size_m[:2] if each.shape == "box" else [each.size_m[0]] * 2) for each in cell.obstacles.values()
    ]
    rise = [0.0] * len(places) + [each.half_height_m for each in cell.obstacles.values()]
    poses = np.concatenate([places, obstacles])
    middle = poses[:, :3] + np.array(rise)[:, None] * [0.0, 0.0, 1.0]
    yaw = 2 * np.arctan2(poses[:, 6], poses[:, 3])
    return np.concatenate([middle, np.array(half), yaw[:, None]], axis=1)


def inside(top: Array, table: Array) -> bool:
    """Return whether one of `tops` (6,), seen from above, is within another (6,)."""
    (x, y), turned = top[:2] - table[:2], abs(np.array([np.cos(top[5] - table[5]), np.sin(top[5] - table[5])]))
    cos, sin = np.cos(table[5]), np.sin(table[5])
    reach = np.abs([cos * x + sin * y, cos * y - sin * x]) + np.array([turned @ top[3:5], turned @ top[4:2:-1]])
    return bool((reach <= table[3:5] + ROUNDED).all())


def behind(places: Array) -> Array:
    """Return the stations (M, 2) m behind `places` (M, 2) m, as seen from the robot."""
    distance = np.linalg.norm(places, axis=1, keepdims=True)
    return np.asarray(places * (1 + BEHIND_M / np.maximum(distance, 1e-6)))
