"""Parts that a gripper adds to a cell: contacts that hold, a guard round what is held, sensors, a model to plan by."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import mujoco
import numpy as np
from dm_control import mjcf
from numpy.typing import NDArray

from hrl_comfort.config import CellConfig, ConfigError
from hrl_comfort.scene.grippers.gripper import DRIVE, PEOPLE, Gripper

ROOM_M = 0.02
"""Smallest room that an open hand needs round an object."""
LEAST_ROOM_M = 0.01
"""That round one which `randomise.object_size` makes larger."""
ROUNDED = 1e-9
"""Rounding of a hundred times a factor."""
GUARD = "guard"
"""Name of the capsule that people touch in the place of what is held."""
GUARD_MARGIN_M = 0.01
"""Distance of an object's middle from the tool for which the guard allows."""
FINGERS_M = 0.09
"""Length of the fingers before the tool centre point that the guard covers."""


def check_fits(gripper: Gripper, cell: CellConfig, largest: float) -> None:
    """Raise ConfigError if an object is too wide for the hand, or is when it is `largest` times as large."""
    for name, each in cell.objects.items():
        width = 2 * min(each.half_m[:2])
        if width > gripper.opening_m - ROOM_M:
            raise ConfigError(
                f"cell.objects.{name}.size_m={each.size_m} is {width:.3g} m wide; {gripper.name} opens to "
                f"{gripper.opening_m:.3g} m and takes up to {gripper.opening_m - ROOM_M:.3g} m"
            )
        if width * largest > gripper.opening_m - LEAST_ROOM_M:
            raise ConfigError(
                f"randomise.object_size up to {largest:g} makes cell.objects.{name} {width * largest:.3g} m wide; for "
                f"{gripper.name} give at most {floored((gripper.opening_m - LEAST_ROOM_M) / width):g}"
            )


def floored(factor: float) -> float:
    """Return a factor with two decimals that is not above it."""
    return math.floor(100 * factor + ROUNDED) / 100


def hold_firmly(root: mjcf.RootElement) -> None:
    """Set the contacts of a cell so that what is held does not slip (dm_control and menagerie hands do the same)."""
    root.option.cone, root.option.impratio = "elliptic", 10


def add_guard(root: mjcf.RootElement, gripper: Gripper, cell: CellConfig, limbs: Sequence[str], largest: float) -> None:
    """Add a capsule round the open pads and all that the hand may hold: objects up to `largest` times their size.

    People touch it, and it counts for the shield.
    """
    tool = root.find("site", "robot/tcp")
    widest = largest * max(math.dist((0, 0, 0), each.half_m) for each in cell.objects.values())
    length = max(FINGERS_M - widest, 0.001)
    radius = max(widest + GUARD_MARGIN_M, _pads_reach(root, gripper, length))
    x, y, z = tool.pos
    tool.parent.add(
        "geom", name=GUARD, type="capsule", fromto=(x, y, z - length, x, y, z), size=[radius], contype=PEOPLE,
        conaffinity=0, condim=1, mass=0, group=4, rgba=(1, 1, 1, 0.1),
    )  # fmt: skip
    for limb in limbs:
        for geom in root.find("body", limb).geom:
            geom.conaffinity = 1 | PEOPLE


def half_width_m(model: mujoco.MjModel) -> float:
    """Return how far, m, the open hand of a planning `model` reaches from the tool's axis, near its tip.

    What collides with objects counts.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    tool, farthest = data.site("robot/tcp"), 0.0
    hand = {model.site("robot/tcp").bodyid[0]}
    for body in range(model.nbody):
        if model.body_parentid[body] in hand:
            hand.add(body)
    for geom in range(model.ngeom):
        collides = model.geom_contype[geom] & 1 and model.geom(geom).name != f"robot/{GUARD}"
        if collides and model.geom_bodyid[geom] in hand:
            at = _corners(model, data, geom, tool)
            if at[:, 2].max() > -FINGERS_M / 2:
                farthest = max(farthest, float(np.linalg.norm(at[:, :2], axis=1).max()))
    return farthest


def _corners(model: mujoco.MjModel, data: mujoco.MjData, geom: int, tool: Any) -> NDArray[np.float64]:
    """Return the corners (8, 3) m of the box round a geom in the frame of the site `tool`."""
    corners = model.geom_aabb[geom, :3] + np.array(list(product((-1, 1), repeat=3))) * model.geom_aabb[geom, 3:]
    at = data.geom_xpos[geom] + corners @ data.geom_xmat[geom].reshape(3, 3).T
    return np.asarray((at - tool.xpos) @ tool.xmat.reshape(3, 3))


def _pads_reach(root: mjcf.RootElement, gripper: Gripper, length: float) -> float:
    """Return how far, m, the open pads reach from an axis of `length` m that ends at the tool.

    Capsules and spheres of the pads are left out: they count for the shield themselves.
    """
    model = mujoco.MjModel.from_xml_string(root.to_xml_string(), root.get_assets())
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    tool, farthest = data.site("robot/tcp"), 0.0
    pads = [model.body(f"robot/{name}").id for name in gripper.pads]
    for geom in np.flatnonzero(np.isin(model.geom_bodyid, pads)):
        if model.geom_type[geom] in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_SPHERE):
            continue
        at = _corners(model, data, int(geom), tool)
        at[:, 2] -= at[:, 2].clip(-length, 0.0)
        farthest = max(farthest, float(np.linalg.norm(at, axis=1).max()))
    return farthest


def add_hand_sensors(root: mjcf.RootElement, gripper: Gripper, objects: Sequence[str]) -> dict[str, int]:
    """Add the sensors of hand and objects; return their sizes in order of sensordata.

    `time` (1) s; `hand_pos`, `hand_vel` (1), of the drive, in its unit; `tcp_quat` (4). Of all bodies of objects B:
    `object_pos` (B, 3) m, `object_quat` (B, 4), `object_vel` (B, 3) m/s, `pads` (B, 2), contacts with the two pads.
    """
    add = root.sensor.add
    add("clock", name="time")
    for kind in ("pos", "vel"):
        add(f"actuator{kind}", name=f"hand_{kind}", actuator=f"robot/{DRIVE}")
    add("framequat", name="tcp_quat", objtype="site", objname="robot/tcp")
    for kind, sensor in (("pos", "framepos"), ("quat", "framequat"), ("vel", "framelinvel")):
        for name in objects:
            add(sensor, name=f"{name}_{kind}", objtype="xbody", objname=name)
    for name in objects:
        for pad in gripper.pads:
            add("contact", name=f"{name}_{pad}", body1=f"robot/{pad}", body2=name, data="found", num=1)
    count = len(objects)
    held = {"object_pos": 3 * count, "object_quat": 4 * count, "object_vel": 3 * count, "pads": 2 * count}
    return {"time": 1, "hand_pos": 1, "hand_vel": 1, "tcp_quat": 4, **held}


def planning_model(xml: str, assets: Mapping[str, bytes], joints: Sequence[str]) -> tuple[mujoco.MjModel, str]:
    """Return a model without objects and with fingers that stand open, and its XML; its joints are `joints`.

    The guard collides with the cell, so that what is held keeps clear of it.
    """
    spec = mujoco.MjSpec.from_string(xml, assets=dict(assets))
    for actuator in [each for each in spec.actuators if each.target not in joints]:
        spec.delete(actuator)
    for group in (spec.sensors, spec.equalities, spec.tendons):
        for each in list(group):
            spec.delete(each)
    for joint in [each for each in spec.joints if each.name not in joints]:
        body = joint.parent
        spec.delete(body if joint.type == mujoco.mjtJoint.mjJNT_FREE else joint)
    spec.geom(f"robot/{GUARD}").contype = 1
    model = spec.compile()
    return model, spec.to_xml()
