"""Doubts about a cell before it is simulated: goals that the arm cannot reach, furniture in furniture."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import combinations
from operator import attrgetter

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import CellConfig, EnvConfig, HierarchyTrainConfig
from hrl_comfort.config.commands import PICK_AND_PLACE
from hrl_comfort.scene.robots import robot_named

DROPS = ("cell.orange_drop_m", "cell.pink_drop_m")
GOALS = {
    "pick": ("cell.ball_m",),
    "place": DROPS,
    "reach": ("task.point_m",),
    "point_to_point": ("task.point_m", "task.second_point_m"),
    **dict.fromkeys(PICK_AND_PLACE, ("cell.ball_m", *DROPS)),
}
"""Keys of the points that the tool goes to, by task."""
PEDESTAL_M = 0.08
"""Radius of the robot's pedestal."""
ANGLES, ROUNDS = 72, 4
"""Of the search for the farthest point that an arm reaches."""


def layout_warnings(config: EnvConfig) -> Iterator[str]:
    """Yield what is likely wrong with the layout of a cell, a line each."""
    task, name = config.task, "cycle" if isinstance(config, HierarchyTrainConfig) else config.task.name
    shoulder, most = reach(config.robot.name)
    for key in GOALS.get(name, ()):
        if key == "task.point_m" and name == "reach" and task.point == "random":
            continue
        point, precision = attrgetter(key)(config), task.precision
        near = precision.place_tolerance_m if key in DROPS else precision.grasp_tolerance_m
        away = float(np.linalg.norm(np.array(point) - shoulder))
        if away > most + near:
            yield (
                f"{key}={point} is {away:.2f} m from the shoulder of {config.robot.name}, "
                f"which reaches {most:.2f} m: the task cannot be done"
            )
    yield from _overlaps(config.cell)


def _overlaps(cell: CellConfig) -> Iterator[str]:
    places = {f"cell.{name}": getattr(cell, name) for name in ("ball_m", "orange_drop_m", "pink_drop_m")}
    side = 2 * cell.table_half_width_m
    for (one, (x, y, _)), (other, (u, v, _)) in combinations(places.items(), 2):
        if abs(x - u) < side and abs(y - v) < side:
            yield f"the tables of {one} and {other} overlap: move one, or reduce cell.table_half_width_m"
    for key, (x, y, z) in places.items():
        if max(abs(x), abs(y)) < side / 2 + PEDESTAL_M:
            yield f"{key}={[x, y, z]}: its table stands in the robot's pedestal"
        if z - cell.ball_radius_m < -cell.base_height_m:
            yield f"{key}={[x, y, z]}: its table is below the floor, at {-cell.base_height_m} m (cell.base_height_m)"


@lru_cache(maxsize=8)
def reach(robot: str) -> tuple[NDArray[np.float64], float]:
    """Return an arm's shoulder (3,) m, the anchor of its second joint, and the tool's largest distance from it, m.

    The distance is found by turning one joint after the other to the best of ANGLES angles within its limits.
    """
    model = mujoco.MjModel.from_xml_string((root := robot_named(robot).build()).to_xml_string(), root.get_assets())
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
