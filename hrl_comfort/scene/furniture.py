"""Things round the robot, and its objects: floor, pedestal, places, obstacles and props of a cell.

Places and obstacles are mocap bodies: where they stand is part of the control vector, so that each cell of a batch can
have a layout of its own.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from dm_control import mjcf
from numpy.typing import NDArray

from hrl_comfort.config import FAR_AWAY_M, CellConfig, ObjectConfig, ObstacleConfig, PlaceConfig

STANDS = ("pedestal", "floor")
"""Names of the bodies that stand still in every cell."""
POINTS = ("first_point", "second_point")
"""Names of the props that mark the points of `reach` and `point_to_point`."""
THICKNESS_M = 0.02
"""Of a place's top."""
PEDESTAL_M = 0.08
"""Radius of the robot's pedestal."""
_LEG_M, _LONGEST_LEG_M = 0.02, 4.0
_POINT_M = 0.045
_WOOD, _STEEL, _GREY = (0.6, 0.45, 0.3, 1), (0.45, 0.47, 0.5, 1), (0.75, 0.76, 0.75, 1)
_GREEN, _BLUE = (0.2, 0.8, 0.3, 0.4), (0.2, 0.4, 0.9, 0.4)
_TURNING_M = (0.005, 0.0005)
"""Coefficients of torsional and of rolling friction of objects."""
_SOLID = {"contype": 0, "conaffinity": 1, "condim": 1}
"""Of a geom that the robot's collide with, and nothing else."""
_LOOSE = 4
"""Bit of the contacts between loose objects, and with what stands in the cell."""


def furniture(cell: CellConfig) -> tuple[str, ...]:
    """Return the names (F) of the bodies of the places, then of the obstacles."""
    return (*(f"place_{name}" for name in cell.places), *(f"obstacle_{name}" for name in cell.obstacles))


def layout(cell: CellConfig) -> NDArray[np.float64]:
    """Return the poses (F, 7) of `furniture`: m and quaternion, of a place the middle of its top."""
    poses = [(*each.top_m, *turn(math.radians(each.yaw_deg))) for each in cell.places.values()]
    poses += [(*each.position_m, *turn(math.radians(each.yaw_deg))) for each in cell.obstacles.values()]
    return np.array(poses, dtype=np.float64)


def turn(yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion, w first, of a turn about the vertical by `yaw` rad."""
    return math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)


def object_names(cell: CellConfig, objects: int) -> list[str]:
    """Return the names of the bodies that show `objects` objects: of each in turn, one of each kind."""
    return [f"object_{index + 1}_{kind}" for index in range(objects) for kind in cell.objects]


def add_surroundings(world: mjcf.Element, cell: CellConfig) -> None:
    """Add floor, pedestal, light and cameras."""
    floor_z = -cell.base_height_m
    world.add("light", name="lamp", directional=True, pos=(0.3, -0.6, 3), dir=(-0.1, 0.2, -1), diffuse=(0.5,) * 3)
    world.add("camera", name="top", pos=(0, 0, 3.0), xyaxes=(1, 0, 0, 0, 1, 0), fovy=50)
    world.add("camera", name="side", pos=(0.4, -2.6, 1.3), xyaxes=(1, 0.15, 0, -0.05, 0.35, 0.93), fovy=50)
    world.add("geom", name="floor", type="plane", pos=(0, 0, floor_z), size=(3, 3, 0.1), rgba=_GREY, **_SOLID)
    post = world.add("body", name="pedestal")
    foot = min(floor_z, -0.01)  # a robot on the floor keeps a plate for the pedestal's contact sensor
    post.add(
        "geom", name="pedestal", type="cylinder", fromto=(0, 0, foot, 0, 0, 0), size=[PEDESTAL_M], rgba=_STEEL, **_SOLID
    )


def add_furniture(world: mjcf.Element, cell: CellConfig) -> None:
    """Add places, with a mark where objects of each kind belong, and obstacles."""
    poses = dict(zip(furniture(cell), layout(cell), strict=True))
    for name, place in cell.places.items():
        body = _body(world, f"place_{name}", poses)
        _add_top(body, name, place)
        for kind, each in cell.objects.items():
            if each.belongs_at == name:
                look = {"size": [1.5 * each.half_width_m], "rgba": (*each.rgb, 0.3)}
                body.add("site", name=f"{kind}_goal", pos=(0, 0, each.half_height_m), **look)
    for name, obstacle in cell.obstacles.items():
        body = _body(world, f"obstacle_{name}", poses)
        body.add("geom", name=f"obstacle_{name}", rgba=(*obstacle.rgb, 1), **_shape(obstacle), **_SOLID)


def _body(world: mjcf.Element, name: str, poses: dict[str, NDArray[np.float64]]) -> mjcf.Element:
    return world.add("body", name=name, mocap=True, pos=poses[name][:3], quat=poses[name][3:])


def _add_top(body: mjcf.Element, name: str, place: PlaceConfig) -> None:
    """Add a place's top and its legs, which reach into the floor, however high the top stands."""
    (x, y), half = (side / 2 for side in place.size_m), THICKNESS_M / 2
    body.add("geom", name=f"{name}_top", type="box", pos=(0, 0, -half), size=(x, y, half), rgba=_WOOD, **_SOLID)
    for index, (u, v) in enumerate(leg_axes(place)):
        axis = (u, v, -half - 0.03, u, v, -_LONGEST_LEG_M)
        body.add("geom", name=f"{name}_leg_{index}", type="capsule", fromto=axis, size=[_LEG_M], rgba=_STEEL, **_SOLID)


def leg_axes(place: PlaceConfig) -> list[tuple[float, float]]:
    """Return where the axes of a place's legs are, m, in its frame."""
    if place.legs < 2:
        return [(0.0, 0.0)][: place.legs]
    x, y = (side / 2 - _LEG_M for side in place.size_m)
    return [(side * x, end * y) for side in (-1, 1) for end in (-1, 1)]


def _shape(each: ObjectConfig | ObstacleConfig) -> dict[str, Any]:
    return {"type": each.shape, "size": each.size_m}


def add_props(world: mjcf.Element, cell: CellConfig, objects: int, loose: bool) -> None:
    """Add the marks of points, and bodies of each kind for `objects` objects.

    Objects are sites, which have no contacts, or `loose` bodies with mass and friction.
    """
    if loose:
        for name in (*furniture(cell), STANDS[0]):
            for geom in world.root.find("body", name).geom:
                geom.conaffinity = 1 | _LOOSE
        world.root.find("geom", STANDS[1]).conaffinity = 1 | _LOOSE
    for name, colour in zip(POINTS, (_GREEN, _BLUE), strict=True):
        body = world.add("body", name=name, mocap=True, pos=(FAR_AWAY_M, 0, 0))
        body.add("site", name=name, size=[_POINT_M], rgba=colour)
    for name, each in zip(object_names(cell, objects), [*cell.objects.values()] * objects, strict=True):
        if loose:
            _add_loose(world, name, each)
        else:
            body = world.add("body", name=name, mocap=True, pos=(FAR_AWAY_M, 0, 0))
            body.add("site", name=name, rgba=(*each.rgb, 1), **_shape(each))


def _add_loose(world: mjcf.Element, name: str, each: ObjectConfig) -> None:
    """Add an object that moves freely. Its contacts have its own friction; what is round does not roll for ever.

    People pass through it: limbs move without regard to forces, and the arm would pay for what they throw down.
    """
    body = world.add("body", name=name, pos=(FAR_AWAY_M, 0, 0))
    body.add("freejoint", name=name)
    body.add(
        "geom", name=name, rgba=(*each.rgb, 1), mass=each.mass_kg, contype=_LOOSE, conaffinity=1 | _LOOSE, priority=1,
        condim=4 if each.shape == "box" else 6, friction=(each.friction, *_TURNING_M), solref=(0.01, 1),
        solimp=(0.95, 0.99, 0.001, 0.5, 2), **_shape(each),
    )  # fmt: skip
