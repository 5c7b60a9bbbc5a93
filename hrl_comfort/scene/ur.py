"""Universal Robots e-series arms built from their DH tables, with a two-finger gripper.

The numbers are hardware facts with their sources; experiment choices are in `conf/`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
from dm_control import mjcf
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hrl_comfort.scene.servos import SERVO_LAG_S

Six = tuple[float, float, float, float, float, float]
Point = tuple[float, float, float]

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1_link", "wrist_2_link", "wrist_3_link")

TOOL_LENGTH_M = 0.19
"""Tool centre point from the flange, along its z axis (RG2 gripper of the paper's cell)."""
GRIPPER_MASS_KG = 0.78
"""OnRobot RG2 datasheet."""
PARALLEL = (1, 2)
"""Joints whose axis is parallel to the next one's."""
FINGER_SPREAD_M = 0.042
"""Half the distance between the axes of the open fingers; an RG2 opens to 0.11 m."""


class EndEffector(Protocol):
    """A part at the flange of an arm."""

    @property
    def name(self) -> str:
        """Value of `robot.end_effector`."""

    def attach(self, flange: mjcf.Element) -> None:
        """Add bodies to the last link, whose frame is the flange's with z outwards, and the site `tcp` at the tool.

        Their capsules and spheres collide, and count for the shield; other shapes are for the eye alone.
        """


@dataclass(frozen=True)
class TwoFingers:
    """A gripper of the size of an OnRobot RG2, open fingers on both sides of the tool."""

    name: str = "rg2"

    def attach(self, flange: mjcf.Element) -> None:
        """See `EndEffector`."""
        gripper = flange.add("body", name="gripper", gravcomp=1)
        radius = 0.030
        inertia = _cylinder_inertia(GRIPPER_MASS_KG, radius, np.array([0.0, 0.0, 0.14]))
        gripper.add("inertial", mass=GRIPPER_MASS_KG, pos=(0, 0, 0.07), diaginertia=inertia)
        dark = (0.2, 0.2, 0.22, 1)
        gripper.add("geom", name="hand", fromto=(0, 0, 0.02, 0, 0, 0.09), size=[radius], rgba=dark)
        for name, side in (("left_finger", FINGER_SPREAD_M), ("right_finger", -FINGER_SPREAD_M)):
            gripper.add("geom", name=name, fromto=(side, 0, 0.10, side, 0, TOOL_LENGTH_M), size=[0.007], rgba=dark)
        gripper.add("site", name="tcp", pos=(0, 0, TOOL_LENGTH_M), size=[0.005], group=4)


NONE: Six = (0.0,) * 6


@dataclass(frozen=True)
class Deltas:
    """Differences of one arm's DH parameters from those of its model, in joint order."""

    theta_rad: Six = NONE
    a_m: Six = NONE
    d_m: Six = NONE
    alpha_rad: Six = NONE


@dataclass(frozen=True)
class UrModel:
    """One arm of the family. Arrays are in joint order; link i is fixed in DH frame i (1 to 6).

    DH convention: frame i = frame i-1 * Rz(q_i + theta_i) * Tz(d_i) * Tx(a_i) * Rx(alpha_i), theta_i = 0 in the model.
    """

    name: str
    a_m: Six
    d_m: Six
    alpha_rad: Six
    mass_kg: Six
    com_m: tuple[Point, Point, Point, Point, Point, Point]
    """Centre of mass of each link, in its own DH frame."""
    torque_nm: Six
    speed_deg_s: Six
    joint_limit_deg: Six
    """Symmetric limits. The hardware allows +-360 deg; planners limit the elbow to +-180 deg."""
    shoulder_radius_m: float
    upper_arm_radius_m: float
    elbow_radius_m: float
    forearm_radius_m: float
    wrist_radius_m: float
    armature_kg_m2: Six
    """Reflected rotor inertia, an estimate; small against the inertia of the links in mid-range poses."""
    stiffness_nm_rad: Six
    """Position servo gain, chosen to follow a ramp of 100 deg/s within 2 deg. Higher gains saturate the
    torque at 2 deg steps and chatter at a physics step of 10 ms."""
    home_deg: Six = (0.0, -90.0, 0.0, 0.0, 90.0, 0.0)
    """That of the authors' scene."""
    deltas: Deltas = Deltas()
    """Of the arm's calibration."""
    end_effector: EndEffector = TwoFingers()

    joints: ClassVar[tuple[str, ...]] = JOINTS

    def build(self) -> mjcf.RootElement:
        """Return the arm with servos and end effector."""
        return build_robot(self)


_ALPHA: Six = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)
_LIMIT: Six = (360.0, 360.0, 180.0, 360.0, 360.0, 360.0)

# DH, masses, centres of mass: Universal Robots, "DH parameters for calculations of kinematics and dynamics".
# Torques and speeds: e-series datasheets and "Max. joint torques". UR3e radii: planning capsules.
UR3E = UrModel(
    name="ur3e",
    a_m=(0.0, -0.24355, -0.2132, 0.0, 0.0, 0.0),
    d_m=(0.15185, 0.0, 0.0, 0.13105, 0.08535, 0.0921),
    alpha_rad=_ALPHA,
    mass_kg=(1.98, 3.4445, 1.437, 0.871, 0.805, 0.261),
    com_m=((0, -0.02, 0), (0.13, 0, 0.1157), (0.05, 0, 0.0238), (0, 0, 0.01), (0, 0, 0.01), (0, 0, -0.02)),
    torque_nm=(54.0, 54.0, 28.0, 9.0, 9.0, 9.0),
    speed_deg_s=(180.0, 180.0, 180.0, 360.0, 360.0, 360.0),
    joint_limit_deg=_LIMIT,
    shoulder_radius_m=0.060,
    upper_arm_radius_m=0.054,
    elbow_radius_m=0.060,
    forearm_radius_m=0.040,
    wrist_radius_m=0.045,
    armature_kg_m2=(0.1, 0.1, 0.1, 0.03, 0.03, 0.03),
    stiffness_nm_rad=(1500.0, 1500.0, 750.0, 300.0, 250.0, 150.0),
)

# Capsule radii of UR5e and UR10e are estimates: those of the UR3e, scaled to the size of the joints.
UR5E = UrModel(
    name="ur5e",
    a_m=(0.0, -0.425, -0.3922, 0.0, 0.0, 0.0),
    d_m=(0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996),
    alpha_rad=_ALPHA,
    mass_kg=(3.761, 8.058, 2.846, 1.37, 1.3, 0.365),
    com_m=(
        (0, -0.02561, 0.00193),
        (0.2125, 0, 0.11336),
        (0.15, 0, 0.0265),
        (0, -0.0018, 0.01634),
        (0, 0.0018, 0.01634),
        (0, 0, -0.001159),
    ),
    torque_nm=(150.0, 150.0, 150.0, 28.0, 28.0, 28.0),
    speed_deg_s=(180.0, 180.0, 180.0, 180.0, 180.0, 180.0),
    joint_limit_deg=_LIMIT,
    shoulder_radius_m=0.065,
    upper_arm_radius_m=0.058,
    elbow_radius_m=0.060,
    forearm_radius_m=0.045,
    wrist_radius_m=0.045,
    armature_kg_m2=(0.2, 0.2, 0.2, 0.05, 0.05, 0.05),
    stiffness_nm_rad=(3000.0, 4500.0, 2250.0, 500.0, 400.0, 250.0),
)

UR10E = UrModel(
    name="ur10e",
    a_m=(0.0, -0.6127, -0.57155, 0.0, 0.0, 0.0),
    d_m=(0.1807, 0.0, 0.0, 0.17415, 0.11985, 0.11655),
    alpha_rad=_ALPHA,
    mass_kg=(7.369, 13.051, 3.989, 2.1, 1.98, 0.615),
    com_m=((0.021, 0, 0.027), (0.38, 0, 0.158), (0.24, 0, 0.068), (0, 0.007, 0.018), (0, 0.007, 0.018), (0, 0, -0.026)),
    torque_nm=(330.0, 330.0, 150.0, 56.0, 56.0, 56.0),
    speed_deg_s=(120.0, 120.0, 180.0, 180.0, 180.0, 180.0),
    joint_limit_deg=_LIMIT,
    shoulder_radius_m=0.080,
    upper_arm_radius_m=0.075,
    elbow_radius_m=0.070,
    forearm_radius_m=0.055,
    wrist_radius_m=0.050,
    armature_kg_m2=(0.4, 0.4, 0.3, 0.1, 0.1, 0.1),
    stiffness_nm_rad=(8500.0, 12500.0, 5000.0, 900.0, 700.0, 500.0),
)

UR_ARMS: dict[str, UrModel] = {model.name: model for model in (UR3E, UR5E, UR10E)}


def link_poses(model: UrModel) -> list[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]]:
    """Return position (3,) m, rotation (3, 3) and quaternion (4,) of each link in the one before, all joints at 0.

    Shoulder, elbow and wrist 1 turn about almost parallel axes, so a calibration has their common normals at any
    angle and hundreds of metres away. A DH frame may be moved along and turned about its z axis where the next one
    makes up for it: links 2 and 3 stay where the model has them.
    """
    poses, turned, moved = [], 0.0, 0.0
    for i in range(6):
        a, d, alpha = _dh(model, i)
        first, depth = model.deltas.theta_rad[i] - turned, d - moved
        turned, moved = (-first, (model.d_m[i] - depth) / np.cos(alpha)) if i in PARALLEL else (0.0, 0.0)
        bent = np.array([[1, 0, 0], [0, np.cos(alpha), -np.sin(alpha)], [0, np.sin(alpha), np.cos(alpha)]])
        place = _about_z(first) @ (bent @ (0.0, 0.0, moved) + (a, 0.0, depth))
        quaternion = Rotation.from_euler("ZXZ", (first, alpha, turned)).as_quat(scalar_first=True)
        poses.append((place, _about_z(first) @ bent @ _about_z(turned), quaternion))
    return poses


def _dh(model: UrModel, i: int) -> tuple[float, float, float]:
    """Return a (m), d (m) and alpha (rad) of joint i, calibration included."""
    deltas = model.deltas
    return model.a_m[i] + deltas.a_m[i], model.d_m[i] + deltas.d_m[i], model.alpha_rad[i] + deltas.alpha_rad[i]


def _about_z(angle: float) -> NDArray[np.float64]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def build_robot(model: UrModel) -> mjcf.RootElement:
    """Return the arm with servos and end effector: bodies `base`, LINKS and those of it; sites `flange`, `tcp`.

    The body frame of a link is its DH frame, as for the published centres of mass; site `flange` has the pose
    of DH table and calibration. Actuators take joint angles in rad.
    """
    root = mjcf.RootElement(model="robot")
    root.compiler.angle = "radian"
    geom = root.default.geom
    # Frictionless contacts: a contact ends the episode, so only its detection matters.
    geom.type, geom.contype, geom.conaffinity, geom.condim = "capsule", 1, 1, 1
    geom.rgba = (0.75, 0.78, 0.8, 1)

    body = root.worldbody.add("body", name="base")
    post, dark = (0, 0, 0.03, 0, 0, 0.5 * model.d_m[0]), (0.3, 0.3, 0.33, 1)
    body.add("geom", name="base", fromto=post, size=[model.shoulder_radius_m], mass=0, rgba=dark)
    poses = link_poses(model)
    for i, (link, joint) in enumerate(zip(LINKS, JOINTS, strict=True)):
        place, turn, quaternion = poses[i]
        body = body.add("body", name=link, pos=place, quat=quaternion, gravcomp=1)
        # The joint axis is z of the link before, expressed in the frame of this link.
        limit = np.radians(model.joint_limit_deg[i])
        body.add(
            "joint",
            name=joint,
            axis=turn[2],
            pos=-place @ turn,
            range=(-limit, limit),
            limited=True,
            armature=model.armature_kg_m2[i],
        )
        radius, start, end = _cylinder(model, i)
        inertia = _cylinder_inertia(model.mass_kg[i], radius, np.subtract(end, start))
        body.add("inertial", mass=model.mass_kg[i], pos=model.com_m[i], diaginertia=inertia)
        body.add("geom", name=link, fromto=(*start, *end), size=[radius])
        torque, stiffness = model.torque_nm[i], model.stiffness_nm_rad[i]
        root.actuator.add(
            "position",
            name=joint,
            joint=joint,
            kp=stiffness,
            kv=SERVO_LAG_S * stiffness,
            ctrlrange=(-limit, limit),
            forcerange=(-torque, torque),
        )
        if link == "upper_arm":
            _, side, _ = _sides(model)
            housing = (0, 0, model.com_m[1][2], 0, 0, side)
            body.add("geom", name="elbow", fromto=housing, size=[model.elbow_radius_m])
    body.add("site", name="flange", size=[0.005], group=4)
    model.end_effector.attach(body)
    # MuJoCo does not exclude neighbours of the base, which is welded to the world. The wrist capsules are wider
    # than the housings and touch where the hardware does not.
    for pair in ("base shoulder", "base upper_arm", "forearm wrist_2_link", "wrist_1_link wrist_3_link"):
        first, second = pair.split()
        root.contact.add("exclude", body1=first, body2=second)
    return root


def _sides(model: UrModel) -> tuple[float, float, float]:
    """Return the lateral offsets of upper arm, forearm and wrist from the shoulder's plane, m.

    The DH table has one offset, d4; the centres of mass give those of the links.
    """
    return model.com_m[1][2], model.com_m[2][2], model.d_m[3]


def _cylinder(model: UrModel, i: int) -> tuple[float, Point, Point]:
    """Return the radius and axis ends of the cylinder of link i, in DH frame i, m."""
    upper, fore, wrist = _sides(model)
    thin = model.wrist_radius_m
    return (
        (model.shoulder_radius_m, (0.0, 0.0, 0.0), (0.0, 0.0, upper)),
        (model.upper_arm_radius_m, (-model.a_m[1], 0.0, upper), (0.0, 0.0, upper)),
        (model.forearm_radius_m, (-model.a_m[2], 0.0, fore), (0.0, 0.0, fore)),
        (thin, (0.0, fore - wrist, 0.0), (0.0, 0.0, 0.0)),
        (thin, (0.0, model.d_m[4], 0.0), (0.0, 0.0, 0.0)),
        (thin, (0.0, 0.0, -model.d_m[5]), (0.0, 0.0, -thin)),
    )[i]


def _cylinder_inertia(mass: float, radius: float, axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the diagonal inertia (3,) kg m^2 of a solid cylinder along one coordinate axis."""
    length = np.linalg.norm(axis)
    across, along = mass * (3 * radius**2 + length**2) / 12, mass * radius**2 / 2
    return np.where(np.abs(axis) > 0.5 * length, along, across)
