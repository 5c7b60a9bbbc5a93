"""The cell (robot, tables, pedestal, floor, human), compiled to one MuJoCo model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from dm_control import mjcf
from numpy.typing import ArrayLike, NDArray

from hrl_comfort.config import CONTROL_STEP_S, FAR_AWAY_M, CellConfig, ConfigError, EnvConfig, RobotConfig
from hrl_comfort.scene.calibration import calibrated
from hrl_comfort.scene.furniture import (
    POINTS,
    STANDS,
    add_furniture,
    add_props,
    add_surroundings,
    furniture,
    layout,
    object_names,
)
from hrl_comfort.scene.grippers.cell import add_guard, add_hand_sensors, check_fits, hold_firmly, planning_model
from hrl_comfort.scene.grippers.gripper import Gripper, Hand
from hrl_comfort.scene.human import build_human, limb_poses, limbs_of_person
from hrl_comfort.scene.robots import Robot, equipped
from hrl_comfort.scene.ur import UrModel

CONTROL_SPEC = mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_MOCAP_POS | mujoco.mjtState.mjSTATE_MOCAP_QUAT
"""Layout of a control vector: ctrl (J, with a gripper J + 1), mocap positions (nmocap * 3) and quaternions
(nmocap * 4)."""


@dataclass(frozen=True)
class Scene:
    """A compiled cell with the layout of its state, controls and sensors."""

    robot: str
    """Its name, as of `scene.robots.robot_named`."""
    cell: CellConfig
    joints: tuple[str, ...]
    """Names of its J joints in the model, base first."""
    xml: str
    assets: Mapping[str, bytes]
    model: mujoco.MjModel
    sensors: Mapping[str, slice]
    """Slices of sensordata: joint_pos (J) rad, joint_vel (J) rad/s, tcp_pos (3) m; numbers of contacts with
    the robot: human (L, by `limbs`), table (F + 2, by `furniture`, then pedestal and floor), self (1). With a gripper
    also those of `scene.grippers.cell.add_hand_sensors`."""
    home: NDArray[np.float64]
    """(J,) rad."""
    joint_range: NDArray[np.float64]
    """(J, 2) rad."""
    nstate: int
    """Length of mjSTATE_FULLPHYSICS."""
    ncontrol: int
    """Length of CONTROL_SPEC."""
    mocap: tuple[str, ...]
    """Names of the mocap bodies by mocap index: `limbs`, `furniture`, then the props: POINTS, and without a gripper for
    each object a body of each kind."""
    limbs: tuple[str, ...]
    """Names of the L bodies of people: LIMBS of the first, then those of the others."""
    furniture: tuple[str, ...]
    """Names of the F bodies that the robot can touch beside people: the places, then the obstacles."""
    layout: NDArray[np.float64]
    """(F, 7) m and quaternion, poses of `furniture` in the cell's configuration; a place's is the middle of its top."""
    floor_z: float
    gripper: Gripper | None
    """The gripper whose fingers hold objects; None where these ride on the tool."""
    planning: mujoco.MjModel
    """`model`, with a gripper without objects and with fingers that stand open: its qpos is that of the joints."""
    planning_xml: str
    """XML of `planning`; `assets` go with it."""
    moving: NDArray[np.int64]
    """(2 J,) indices of the joints' angles and velocities in mjSTATE_FULLPHYSICS."""
    loose: tuple[str, ...]
    """Names of the objects that move freely, for each object a body of each kind; none without a gripper."""

    @property
    def first_prop(self) -> int:
        """Mocap index of the first prop; props have no contacts, and unused ones stand at x = FAR_AWAY_M."""
        return self.first_furniture + len(self.furniture)

    @property
    def first_furniture(self) -> int:
        """Mocap index of the first of `furniture`."""
        return len(self.limbs)

    @property
    def hand_capsules(self) -> int:
        """Number of capsules and spheres of the gripper and of what it may hold; of the arm's, they are the last."""
        model = self.planning
        last = int(model.jnt_bodyid[-1])
        on_hand = (model.body_weldid == last) & (np.arange(model.nbody) != last)
        rounded = np.isin(model.geom_type, (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_SPHERE))
        return 0 if self.gripper is None else int((rounded & on_hand[model.geom_bodyid]).sum())

    @property
    def still(self) -> tuple[str, ...]:
        """Names of the bodies that the robot must not touch beside people and itself, by the sensor `table`."""
        return (*self.furniture, *STANDS)

    def object_prop(self, index: ArrayLike, kind: ArrayLike) -> NDArray[np.int64]:
        """Return the index among the props of the body of objects of a kind; both (...,)."""
        return len(POINTS) + np.asarray(index) * len(self.cell.objects) + np.asarray(kind)


DEEPEST_M = 0.05
"""Depth of an overlap with the first link up to which contacts are told and not resolved."""


def build_scene(
    robot: RobotConfig, cell: CellConfig, substeps: int, objects: int = 1, people: int = 1, largest: float = 1.0
) -> Scene:
    """Compile the cell with `substeps` physics steps a control step of 20 ms, for some `objects` and `people`.

    The hand is to hold objects up to `largest` times their size.

    Raises:
      ConfigError: there is no such robot, `robot.home_deg` is not a number for each of its joints,
        `robot.calibration` does not fit the robot, or MuJoCo does not take the gripper.
    """
    arm = equipped(robot.name, robot.end_effector, robot.gripper)
    if robot.calibration is not None:
        arm = calibrated(arm, robot.name, robot.calibration)
    home = arm.home_deg if robot.home_deg is None else robot.home_deg
    if len(home) != len(arm.joints):
        raise ConfigError(
            f"robot.home_deg={list(home)} has {len(home)} angles; robot.name={robot.name} has {len(arm.joints)} joints"
        )
    names = tuple(f"robot/{name}" for name in arm.joints)
    describe = _described_once if isinstance(arm, UrModel) else _described  # others may come from a file that changes
    try:
        xml, assets, sizes = describe(arm, cell, substeps, names, objects, people, largest)
        model = mujoco.MjModel.from_xml_string(xml, assets)
    except ValueError as error:
        if isinstance(error, ConfigError) or not robot.gripper.holds:
            raise
        said = " ".join(str(error).split())
        raise ConfigError(f"robot.gripper.name={robot.gripper.name}: MuJoCo does not take it: {said}") from error
    ends = np.cumsum(list(sizes.values())).tolist()
    joints = [model.joint(name).id for name in names]
    limbs, gripper = limb_names(people), gripper_of(arm)
    planning, planning_xml = model, xml
    if gripper is not None:
        check_fits(gripper, cell, largest)
        planning, planning_xml = planning_model(xml, assets, names)
    kinds = tuple(object_names(cell, objects))
    qpos, dof = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    return Scene(
        robot=robot.name,
        cell=cell,
        joints=names,
        xml=xml,
        assets=assets,
        model=model,
        sensors={key: slice(end - size, end) for (key, size), end in zip(sizes.items(), ends, strict=True)},
        home=np.radians(np.asarray(home, dtype=np.float64)),
        joint_range=model.jnt_range[joints].copy(),
        nstate=mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS),
        ncontrol=mujoco.mj_stateSize(model, CONTROL_SPEC),
        mocap=(*limbs, *furniture(cell), *POINTS, *(kinds if gripper is None else ())),
        limbs=limbs,
        furniture=furniture(cell),
        layout=layout(cell),
        floor_z=-cell.base_height_m,
        gripper=gripper,
        planning=planning,
        planning_xml=planning_xml,
        moving=np.concatenate([1 + qpos, 1 + model.nq + dof]).astype(np.int64),
        loose=() if gripper is None else kinds,
    )


def gripper_of(arm: Robot) -> Gripper | None:
    """Return the gripper of an arm that has one."""
    hand = arm.end_effector if isinstance(arm, UrModel) else None
    return hand.gripper if isinstance(hand, Hand) else None


def scene_of(config: EnvConfig) -> Scene:
    """Return the scene of the cells of `config`.

    Raises:
      ConfigError: as `build_scene`, or objects differ and no hand holds them.
    """
    config.randomise.check_objects(config.robot.gripper.holds)
    people = len(config.human.everyone)
    largest = max(1.0, config.randomise.object_size[1])
    return build_scene(config.robot, config.cell, config.substeps, config.task.objects, people, largest)


def _described(
    arm: Robot, cell: CellConfig, substeps: int, joints: tuple[str, ...], objects: int, people: int, largest: float
) -> tuple[str, Mapping[str, bytes], Mapping[str, int]]:
    """Return XML and assets of a cell, and the sizes of its sensors."""
    root = mjcf.RootElement(model="cell")
    _set_options(root, substeps)
    floor_z = -cell.base_height_m
    add_surroundings(root.worldbody, cell)
    gripper = gripper_of(arm)
    frame = root.attach(arm.build())
    _hold_shoulder(frame.root.find("joint", joints[0]))
    for index in range(people):
        build_human(root.worldbody, limb_poses(FAR_AWAY_M, 0.0, 0.0, 0.0, 0.0, floor_z), index)
    add_furniture(root.worldbody, cell)
    add_props(root.worldbody, cell, objects, loose=gripper is not None)
    sizes = _add_sensors(root, joints, limb_names(people), (*furniture(cell), *STANDS))
    if gripper is not None:
        hold_firmly(root)
        add_guard(root, gripper, cell, limb_names(people), largest)
        sizes |= add_hand_sensors(root, gripper, object_names(cell, objects))
    return root.to_xml_string(), root.get_assets(), sizes


_described_once: Any = lru_cache(maxsize=16)(_described)
"""To describe a cell takes longer than to compile it."""


def tool_at(scene: Scene, joints: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the tool centre point (3,) m at joint angles (J,) rad."""
    data = mujoco.MjData(scene.planning)
    data.qpos[:] = joints
    mujoco.mj_kinematics(scene.planning, data)
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


def limb_names(people: int) -> tuple[str, ...]:
    """Return the names of the bodies of some people."""
    return tuple(limb for index in range(people) for limb in limbs_of_person(index))


def _add_sensors(
    root: mjcf.RootElement, joints: tuple[str, ...], limbs: tuple[str, ...], still: tuple[str, ...]
) -> dict[str, int]:
    """Add the sensors; return their sizes in order of sensordata."""
    add = root.sensor.add
    for kind in ("pos", "vel"):
        for index, joint in enumerate(joints):
            add(f"joint{kind}", name=f"joint_{index}_{kind}", joint=joint)
    add("framepos", name="tcp_pos", objtype="site", objname="robot/tcp")
    found = {"subtree1": "robot/", "data": "found", "num": 1}
    for name in (*limbs, *still[:-1]):
        add("contact", name=f"{name}_contact", body2=name, **found)
    add("contact", name="floor_contact", geom2="floor", **found)
    add("contact", name="self_contact", subtree2="robot/", **found)
    count = len(joints)
    contacts = {"human": len(limbs), "table": len(still), "self": 1}
    return {"joint_pos": count, "joint_vel": count, "tcp_pos": 3, **contacts}
