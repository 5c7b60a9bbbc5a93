"""Robotiq's 2F-85: two fingers on linkages of four links, which keep the pads parallel.

Dimensions, masses and the spring are those that MuJoCo Menagerie publishes for it (robotiq_2f85, after
ROS-Industrial's description, BSD-2-Clause); the shapes are this project's own. There y goes from pad to pad, here x.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from dm_control import mjcf

from hrl_comfort.scene.grippers.gripper import DRIVE, PEOPLE

BASE_M, TOOL_M = 0.0108, 0.152
"""Along z from the flange: origin of the base, tool centre point, between pads that hold."""
CLOSED_RAD = 0.8
"""Angle of the drivers of the closed hand; 0 is open."""
LEVER_M, STIFF_RAD = 0.053, 0.1
"""Way of a pad for each rad of its driver, and position error at which the drive has its full force."""
DRIVER_M, COUPLER_M, TIP_M = (0.0306011, 0.054904), (0.0315, -0.0041), (0.0061, 0.0476)
SPRING_M, FOLLOWER_M, KNUCKLE_M = (0.0132, 0.0609), (0.055, 0.0375), (-0.018, 0.0065)
"""Outwards and along z: joints of the driver in the base, of the coupler in the driver, and the coupler's end; joint of
the spring link in the base, where the follower is connected to the coupler, in the spring link, and from there the
joint between those two."""
PAD_M, FACE_M, PAD_HALF_M = (-0.0189, 0.01352), -0.0026, (0.004, 0.011, 0.01875)
"""Origin of the pad in the follower; middle of its box outwards from there, and half sides."""
BASE_KG, DRIVER_KG, COUPLER_KG, SPRING_KG, FOLLOWER_KG, PAD_KG = 0.777441, 0.009, 0.0141, 0.0222, 0.0125, 0.0035
_DARK, _GREY, _RUBBER = (0.15, 0.15, 0.15, 1), (0.46, 0.46, 0.46, 1), (0.1, 0.1, 0.1, 1)
STEP_S = 0.005
FIRM = {"solref": (2 * STEP_S, 1), "solimp": (0.95, 0.99, 0.001)}
"""Constraints that close the linkages."""
STOP = {"solreflimit": FIRM["solref"], "solimplimit": FIRM["solimp"]}
"""Limit at which driver and coupler turn as one, so that the pad stays parallel until it touches."""


@dataclass(frozen=True)
class Robotiq2F85:
    """Two fingers on linkages, whose drivers one drive turns."""

    name: str = "robotiq_2f85"
    opening_m: float = 0.085
    tip_m: float = 0.024
    pads: tuple[str, str] = ("left_pad", "right_pad")

    def attach(self, flange: mjcf.Element, force_n: float) -> None:
        """See `Gripper`."""
        root = flange.root
        base = flange.add("body", name="gripper", pos=(0, 0, BASE_M), gravcomp=1)
        base.add("inertial", mass=BASE_KG, pos=(0, 0, 0.0355), diaginertia=(2.25e-4, 2.6e-4, 1.53e-4))
        base.add("geom", name="hand", fromto=(0, 0, 0.02, 0, 0, 0.055), size=[0.036], rgba=_DARK)
        base.add("site", name="tcp", pos=(0, 0, TOOL_M - BASE_M), size=[0.005], group=4)
        drive = root.tendon.add("fixed", name=DRIVE)
        for side, outwards in (("left", 1), ("right", -1)):
            _add_finger(base, side, outwards)
            drive.add("joint", joint=f"{side}_driver", coef=0.5)
            root.equality.add("connect", body1=f"{side}_follower", body2=f"{side}_coupler", anchor=(0, 0, 0), **FIRM)
            root.contact.add("exclude", body1="gripper", body2=f"{side}_follower")
        root.equality.add("joint", joint1="right_driver", joint2="left_driver", polycoef=(0, 1, 0, 0, 0), **FIRM)
        for left in ("left_pad", "left_follower"):
            for right in ("right_pad", "right_follower"):
                root.contact.add("exclude", body1=left, body2=right)
        torque = force_n * LEVER_M
        stiffness = torque / STIFF_RAD
        root.actuator.add(
            "position", name=DRIVE, tendon=DRIVE, kp=stiffness, kv=0.1 * stiffness, ctrlrange=(0, CLOSED_RAD),
            forcerange=(-torque, torque),
        )  # fmt: skip


def _add_finger(base: mjcf.Element, side: str, outwards: int) -> None:
    """Add driver and coupler, spring link, follower and pad of one finger."""

    def at(place: tuple[float, float]) -> tuple[float, float, float]:
        return outwards * place[0], 0.0, place[1]

    def link(parent: mjcf.Element, name: str, place: tuple[float, float], **joint: Any) -> mjcf.Element:
        body = parent.add("body", name=f"{side}_{name}", pos=at(place), gravcomp=1)
        body.add("joint", name=f"{side}_{name}", axis=(0, -outwards, 0), limited=True, **joint)
        return body

    def bar(body: mjcf.Element, end: tuple[float, float], mass: float, **more: Any) -> None:
        body.add("geom", name=body.name, fromto=(0, 0, 0, *at(end)), size=[0.007], mass=mass, **more)

    people = {"contype": PEOPLE, "conaffinity": 0}
    driver = link(base, "driver", DRIVER_M, range=(0, CLOSED_RAD), armature=0.005, damping=0.1)
    bar(driver, COUPLER_M, DRIVER_KG, rgba=_GREY, **people)
    coupler = link(driver, "coupler", COUPLER_M, range=(-1.57, 0.0), **STOP)
    bar(coupler, TIP_M, COUPLER_KG, rgba=_DARK, **people)
    spring = link(base, "spring_link", SPRING_M, range=(-0.297, 0.8), stiffness=0.05, springref=2.62, damping=0.00125)
    knuckle = FOLLOWER_M[0] + KNUCKLE_M[0], FOLLOWER_M[1] + KNUCKLE_M[1]
    bar(spring, knuckle, SPRING_KG, rgba=_DARK, **people)
    follower = link(spring, "follower", FOLLOWER_M, pos=at(KNUCKLE_M), range=(-0.873, 0.873))
    bar(follower, PAD_M, FOLLOWER_KG, rgba=_DARK)
    pad = follower.add("body", name=f"{side}_pad", pos=at(PAD_M), gravcomp=1)
    pad.add(
        "geom", name=f"{side}_pad", type="box", pos=at((FACE_M, PAD_HALF_M[2])), size=PAD_HALF_M, mass=PAD_KG,
        rgba=_RUBBER,
    )  # fmt: skip
