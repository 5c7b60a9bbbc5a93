"""The cell (robot, tables, pedestal, floor, human), compiled to one MuJoCo model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from dm_control import mjcf
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S, FAR_AWAY_M, CellConfig, ConfigError, RobotConfig
from hrl_comfort.scene.calibration import calibrated
from hrl_comfort.scene.human import LIMBS, build_human, limb_poses
from hrl_comfort.scene.robots import Robot, robot_named
from hrl_comfort.scene.ur import UrModel

PROPS = ("orange_ball", "pink_ball", "first_point", "second_point")
"""Visual mocap bodies after the limbs; unused ones stand at x = FAR_AWAY_M."""
MOCAP = LIMBS + PROPS
OBSTACLES = ("ball_table", "orange_table", "pink_table", "pedestal", "floor")
CONTROL_SPEC = mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_MOCAP_POS | mujoco.mjtState.mjSTATE_MOCAP_QUAT
"""Layout of a control vector: ctrl (J), mocap positions (nmocap * 3), mocap quaternions (nmocap * 4)."""

_ORANGE, _PINK, _WOOD, _STEEL = (1, 0.5, 0.1), (1, 0.4, 0.7), (0.6, 0.45, 0.3, 1), (0.45, 0.47, 0.5, 1)


@dataclass(frozen=True)
class Scene:
    """A compiled cell with the layout of its state, controls and sensors."""

    robot: str
    """Its name, as of `scene.robots.robot_named`."""
    joints: tuple[str, ...]
    """Names of its J joints in the model, base first."""
    xml: str
    assets: Mapping[str, bytes]
    model: mujoco.MjModel
    sensors: Mapping[str, slice]
    """Slices of sensordata: joint_pos (J) rad, joint_vel (J) rad/s, tcp_pos (3) m; numbers of contacts with
    the robot: human (7, by LIMBS), table (5, by OBSTACLES), self (1)."""
    home: NDArray[np.float64]
    """(J,) rad."""
    joint_range: NDArray[np.float64]
    """(J, 2) rad."""
    nstate: int
    """Length of mjSTATE_FULLPHYSICS."""
    ncontrol: int
    """Length of CONTROL_SPEC."""
    mocap: tuple[str, ...]
    """Names of the mocap bodies by mocap index: LIMBS, PROPS, then two for each further ball."""
    floor_z: float


DEEPEST_M = 0.05
"""Depth of an overlap with the first link up to which contacts are told and not resolved."""


def ball_props(index: int) -> NDArray[np.int64]:
    """Return the indices (2,) among the props of the orange and the pink body of ball `index`."""
    first = 0 if index == 0 else len(PROPS) + 2 * (index - 1)
    return np.array([first, first + 1])


def build_scene(robot: RobotConfig, cell: CellConfig, substeps: int, balls: int = 1) -> Scene:
    """Compile the cell with `substeps` physics steps a control step of 20 ms.

    Raises:
      ConfigError: there is no such robot, `robot.home_deg` is not a number for each of its joints, or
        `robot.calibration` does not fit the robot.
    """
    arm = robot_named(robot.name)
    if robot.calibration is not None:
        arm = calibrated(arm, robot.name, robot.calibration)
    home = arm.home_deg if robot.home_deg is None else robot.home_deg
    if len(home) != len(arm.joints):
        raise ConfigError(
            f"robot.home_deg={list(home)} has {len(home)} angles; robot.name={robot.name} has {len(arm.joints)} joints"
        )
    more = tuple(f"{colour}_ball_{k}" for k in range(2, balls + 1) for colour in ("orange", "pink"))
    names = tuple(f"robot/{name}" for name in arm.joints)
    hashable: Any = {name: tuple(value) for name, value in vars(cell).items() if isinstance(value, list)}
    describe = _described_once if isinstance(arm, UrModel) else _described  # others may come from a file that changes
    xml, assets, sizes = describe(arm, replace(cell, **hashable), substeps, names, PROPS + more)
    model = mujoco.MjModel.from_xml_string(xml, assets)
    ends = np.cumsum(list(sizes.values())).tolist()
    joints = [model.joint(name).id for name in names]
    return Scene(
        robot=robot.name,
        joints=names,
        xml=xml,
        assets=assets,
        model=model,
        sensors={key: slice(end - size, end) for (key, size), end in zip(sizes.items(), ends, strict=True)},
        home=np.radians(np.asarray(home, dtype=np.float64)),
        joint_range=model.jnt_range[joints].copy(),
        nstate=mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS),
        ncontrol=mujoco.mj_stateSize(model, CONTROL_SPEC),
        mocap=MOCAP + more,
        floor_z=-cell.base_height_m,
    )


def _described(
    arm: Robot, cell: CellConfig, substeps: int, joints: tuple[str, ...], props: tuple[str, ...]
) -> tuple[str, Mapping[str, bytes], Mapping[str, int]]:
    """Return XML and assets of a cell, and the sizes of its sensors."""
    root = mjcf.RootElement(model="cell")
    _set_options(root, substeps)
    floor_z = -cell.base_height_m
    _add_surroundings(root.worldbody, cell, floor_z)
    frame = root.attach(arm.build())
    _hold_shoulder(frame.root.find("joint", joints[0]))
    build_human(root.worldbody, limb_poses(FAR_AWAY_M, 0.0, 0.0, 0.0, 0.0, floor_z))
    _add_props(root.worldbody, cell, props)
    sizes = _add_sensors(root, joints)
    return root.to_xml_string(), root.get_assets(), sizes


_described_once: Any = lru_cache(maxsize=16)(_described)
"""To describe a cell takes longer than to compile it."""


def tool_at(scene: Scene, joints: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the tool centre point (3,) m at joint angles (J,) rad."""
    data = mujoco.MjData(scene.model)
    data.qpos[:] = joints
    mujoco.mj_kinematics(scene.model, data)
    return np.array(data.site("robot/tcp").xpos)


def _set_options(root: mjcf.RootElement, substeps: int) -> None:
    root.compiler.angle = "radian"
    root.option.timestep = CONTROL_STEP_S / substeps
    root.option.integrator = "implicitfast"
    # Without warm start the state is qpos and qvel alone.
    root.option.flag.warmstart = "disable"
    screen = getattr(root.visual, "global")
    screen.offwidth, screen.offheight = 640, 480
    root.visual.quality.shadowsize = 1024
    root.visual.quality.offsamples = 0
    root.visual.map.znear = 0.02
    light = root.visual.headlight
    light.ambient, light.diffuse, light.specular = (0.3,) * 3, (0.25,) * 3, (0, 0, 0)
    root.visual.map.shadowclip = 2
    # Explicit: computed from bodies 50 m away, the camera's near plane would cut the cell.
    root.statistic.extent, root.statistic.center = 2.0, (0, 0, 0.2)
    sky = {"type": "skybox", "builtin": "gradient", "width": 64, "height": 64}
    root.asset.add("texture", name="sky", rgb1=(0.8, 0.87, 0.95), rgb2=(0.95, 0.97, 1), **sky)


def _hold_shoulder(joint: mjcf.Element) -> None:
    """Let the link that `joint` moves be touched without a force.

    It cannot give way, since it turns about its own axis: the least push was solved by flinging the joint at 10 rad/s.
    """
    for geom in joint.parent.geom:
        geom.margin, geom.gap = -DEEPEST_M, DEEPEST_M


def _add_surroundings(world: mjcf.Element, cell: CellConfig, floor_z: float) -> None:
    """Add floor, pedestal, tables, drop markers, light and cameras."""
    look = {"contype": 0, "conaffinity": 1, "condim": 1}
    world.add("light", name="lamp", directional=True, pos=(0.3, -0.6, 3), dir=(-0.1, 0.2, -1), diffuse=(0.5,) * 3)
    world.add("camera", name="top", pos=(0, 0, 3.0), xyaxes=(1, 0, 0, 0, 1, 0), fovy=50)
    world.add("camera", name="side", pos=(0.4, -2.6, 1.3), xyaxes=(1, 0.15, 0, -0.05, 0.35, 0.93), fovy=50)
    grey = (0.75, 0.76, 0.75, 1)
    world.add("geom", name="floor", type="plane", pos=(0, 0, floor_z), size=(3, 3, 0.1), rgba=grey, **look)
    post = world.add("body", name="pedestal")
    foot = min(floor_z, -0.01)  # a robot on the floor keeps a plate for the pedestal's contact sensor
    post.add("geom", name="pedestal", type="cylinder", fromto=(0, 0, foot, 0, 0, 0), size=[0.08], rgba=_STEEL, **look)
    goals = {"ball": cell.ball_m, "orange": cell.orange_drop_m, "pink": cell.pink_drop_m}
    half, thick = cell.table_half_width_m, 0.01
    for name, (x, y, z) in goals.items():
        # The goal is the centre of a ball on the table.
        table = world.add("body", name=f"{name}_table", pos=(x, y, z - cell.ball_radius_m - thick))
        table.add("geom", name=f"{name}_top", type="box", size=(half, half, thick), rgba=_WOOD, **look)
        foot = floor_z - (z - cell.ball_radius_m - thick)
        leg = (0, 0, -0.03, 0, 0, foot)
        table.add("geom", name=f"{name}_leg", type="capsule", fromto=leg, size=[0.02], rgba=_STEEL, **look)
    for name, colour in (("orange", _ORANGE), ("pink", _PINK)):
        world.add("site", name=f"{name}_drop", pos=goals[name], size=[1.5 * cell.ball_radius_m], rgba=(*colour, 0.3))


def _add_props(world: mjcf.Element, cell: CellConfig, names: tuple[str, ...]) -> None:
    """Add the balls and point markers as sites, which have no contacts."""
    looks = {"orange": (*_ORANGE, 1), "pink": (*_PINK, 1), "first": (0.2, 0.8, 0.3, 0.4)}
    for name in names:
        body = world.add("body", name=name, mocap=True, pos=(FAR_AWAY_M, 0, 0))
        size = cell.ball_radius_m * (1.0 if "ball" in name else 1.5)
        body.add("site", name=name, size=[size], rgba=looks.get(name.split("_")[0], (0.2, 0.4, 0.9, 0.4)))


def _add_sensors(root: mjcf.RootElement, joints: tuple[str, ...]) -> dict[str, int]:
    """Add the sensors; return their sizes in order of sensordata."""
    add = root.sensor.add
    for kind in ("pos", "vel"):
        for index, joint in enumerate(joints):
            add(f"joint{kind}", name=f"joint_{index}_{kind}", joint=joint)
    add("framepos", name="tcp_pos", objtype="site", objname="robot/tcp")
    found = {"subtree1": "robot/", "data": "found", "num": 1}
    for name in (*LIMBS, *OBSTACLES[:-1]):
        add("contact", name=f"{name}_contact", body2=name, **found)
    add("contact", name="floor_contact", geom2="floor", **found)
    add("contact", name="self_contact", subtree2="robot/", **found)
    count = len(joints)
    contacts = {"human": len(LIMBS), "table": len(OBSTACLES), "self": 1}
    return {"joint_pos": count, "joint_vel": count, "tcp_pos": 3, **contacts}
