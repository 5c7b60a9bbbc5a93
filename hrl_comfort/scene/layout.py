"""Doubts about a cell before it is simulated: goals out of reach, furniture in furniture, no room for people."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from itertools import combinations

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import CellConfig, EnvConfig, GripperConfig, HierarchyTrainConfig, HumanConfig, ObjectConfig
from hrl_comfort.config.commands import PICK_AND_PLACE
from hrl_comfort.scene.furniture import PEDESTAL_M, THICKNESS_M
from hrl_comfort.scene.robots import equipped

Array = NDArray[np.float64]
ENDS = {
    "pick": ("arrives_at",),
    "place": ("belongs_at",),
    "place_fine": ("belongs_at",),
    "return": (),
    **dict.fromkeys(PICK_AND_PLACE, ("arrives_at", "belongs_at")),
}
"""Keys of a kind of object that name a place where the tool goes, by task."""
POINTS = {"reach": ("point_m",), "point_to_point": ("point_m", "second_point_m")}
"""Keys of the points that the tool goes to, by task."""
ROOM = 1.5
"""Sides of a place over those of an object up to which it is a slot, into which the object has to be fitted."""
ANGLES, ROUNDS = 72, 4
"""Of the search for the farthest point that an arm reaches."""


def layout_warnings(config: EnvConfig) -> Iterator[str]:
    """Yield what is likely wrong with the layout of a cell, a line each."""
    shoulder, most = reach(config.robot.name, config.robot.end_effector, config.robot.gripper)
    for key, point, near in _goals(config):
        away = float(np.linalg.norm(np.array(point) - shoulder))
        if away > most + near:
            yield (
                f"{key}={point} is {away:.2f} m from the shoulder of {config.robot.name}, which reaches {most:.2f} m: "
                "the task cannot be done; move it nearer, or choose a longer robot"
            )
    fits = config.robot.gripper.holds and any(is_slot(config.cell, each) for each in config.cell.objects.values())
    if config.task.name == "place_fine" and not fits:
        yield (
            "task=place_fine is for cell=tray, where a gripper fits an object into a slot; here there is none, and the "
            "expert hits what the object is put on in up to a quarter of episodes: choose cell=tray, or task=place"
        )
    yield from _overlaps(config.cell)
    yield from _crowded(config.human, config.cell)


def is_slot(cell: CellConfig, kind: ObjectConfig) -> bool:
    """Return whether objects of a kind have to be fitted into the place that they belong to."""
    return min(cell.places[kind.belongs_at].size_m) < ROOM * 2 * kind.half_width_m


def _goals(config: EnvConfig) -> Iterator[tuple[str, list[float], float]]:
    """Yield where the tool goes: key, point (3,) m, and the distance, m, at which it has arrived."""
    task, cell, precision = config.task, config.cell, config.task.precision
    name = "cycle" if isinstance(config, HierarchyTrainConfig) else task.name
    near = {"arrives_at": precision.grasp_tolerance_m, "belongs_at": precision.place_tolerance_m}
    named = [(getattr(each, end), kind, end) for end in ENDS.get(name, ()) for kind, each in cell.objects.items()]
    told = set()
    for place, kind, end in named:
        if place not in told:
            told.add(place)
            yield f"cell.places.{place}.top_m", cell.centre(kind, place), near[end]
    for key in POINTS.get(name, ()):
        if name != "reach" or task.point != "random":
            yield f"task.{key}", getattr(task, key), precision.grasp_tolerance_m


def _overlaps(cell: CellConfig) -> Iterator[str]:
    boxes = list(_boxes(cell))
    for one, other in combinations(boxes, 2):
        if _meet(one, other):
            yield f"{one[0]} and {other[0]} overlap: move one, or make it smaller"
    pedestal = ("the robot's pedestal", np.zeros(2), np.full(2, PEDESTAL_M), 0.0, -cell.base_height_m, 0.0)
    for box in boxes:
        if _meet(box, pedestal):
            yield f"{box[0]} stands in the robot's pedestal, which has a radius of {PEDESTAL_M:g} m: move it away"
    for name, place in cell.places.items():
        if place.top_m[2] - THICKNESS_M < -cell.base_height_m:
            yield (
                f"cell.places.{name}.top_m={place.top_m} is below the floor, which is at {-cell.base_height_m:g} m "
                "(cell.base_height_m): raise it"
            )


Box = tuple[str, Array, Array, float, float, float]
"""Key, centre (2,) and half sides (2,) m, yaw rad, lowest and highest point m."""


def _boxes(cell: CellConfig) -> Iterator[Box]:
    """Yield the box round each place, legs and all, and round each obstacle."""
    for name, place in cell.places.items():
        low = place.top_m[2] - THICKNESS_M if place.legs == 0 else -cell.base_height_m
        half, yaw = np.array(place.size_m) / 2, math.radians(place.yaw_deg)
        yield f"cell.places.{name}", np.array(place.top_m[:2]), half, yaw, low, place.top_m[2]
    for name, each in cell.obstacles.items():
        tall = each.size_m[-1] + (each.size_m[0] if each.shape == "capsule" else 0.0)
        half = np.array(each.size_m[:2]) if each.shape == "box" else np.full(2, each.size_m[0])
        at, height = np.array(each.position_m[:2]), each.position_m[2]
        yield f"cell.obstacles.{name}", at, half, math.radians(each.yaw_deg), height - tall, height + tall


def _meet(one: Box, other: Box) -> bool:
    """Return whether two boxes overlap, by more than rounding: no axis of theirs separates them."""
    (_, p, half_p, yaw_p, low_p, high_p), (_, q, half_q, yaw_q, low_q, high_q) = one, other
    if min(high_p, high_q) <= max(low_p, low_q) + 1e-6:
        return False
    for yaw in (yaw_p, yaw_p + math.pi / 2, yaw_q, yaw_q + math.pi / 2):
        axis = np.array([math.cos(yaw), math.sin(yaw)])
        if abs(axis @ (p - q)) >= _extent(half_p, yaw_p - yaw) + _extent(half_q, yaw_q - yaw) - 1e-6:
            return False
    return True


def _extent(half: Array, angle: float) -> float:
    """Return half the width of a rectangle, turned by `angle`, along an axis."""
    return float(half[0] * abs(math.cos(angle)) + half[1] * abs(math.sin(angle)))


def _crowded(human: HumanConfig, cell: CellConfig) -> Iterator[str]:
    """Yield that people, who keep `human.keep_out_m` from the places and the base, have nowhere to begin."""
    nearest, farthest = human.spawn_radius_m
    radius, bearing = np.meshgrid(np.linspace(nearest, farthest, 30), np.linspace(-np.pi, np.pi, 120, endpoint=False))
    ground = np.stack([radius * np.cos(bearing), radius * np.sin(bearing)], axis=-1).reshape(-1, 2)
    centres = np.array([[0.0, 0.0], *(goal[:2] for goal in cell.goals.values())])
    apart = np.linalg.norm(ground[:, None] - centres, axis=-1).min(axis=1)
    if human.motion != "none" and human.spawn != "points" and not (apart > human.keep_out_m).any():
        yield (
            f"human.spawn_radius_m={list(human.spawn_radius_m)} is within human.keep_out_m={human.keep_out_m} of the "
            "places and the robot: people can stand nowhere; widen the one, or lower the other"
        )


NO_GRIPPER = GripperConfig()


@lru_cache(maxsize=8)
def reach(
    robot: str, end_effector: str | None = None, gripper: GripperConfig = NO_GRIPPER
) -> tuple[NDArray[np.float64], float]:
    """Return an arm's shoulder (3,) m, the anchor of its second joint, and the tool's largest distance from it, m.

    The distance is found by turning one joint after the other to the best of ANGLES angles within its limits.
    """
    root = equipped(robot, end_effector, gripper).build()
    model = mujoco.MjModel.from_xml_string(root.to_xml_string(), root.get_assets())
    data = mujoco.MjData(model)
    shoulder, best = np.zeros(3), 0.0
    for _ in range(ROUNDS):
        for joint in range(model.njnt):
            found = []
            low, high = model.jnt_range[joint]
            for angle in np.linspace(low, high, ANGLES):
                data.qpos[joint] = angle
                mujoco.mj_kinematics(model, data)
                shoulder = data.xanchor[:2][-1].copy()
                found.append((float(np.linalg.norm(data.site("tcp").xpos - shoulder)), angle))
            best, data.qpos[joint] = max(found)
    return shoulder, best
