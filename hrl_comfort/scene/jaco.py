"""Kinova Jaco with its three-finger hand, from the files of dm_control."""

from __future__ import annotations

from importlib.resources import files

import mujoco

from hrl_comfort.scene.mjcf_arm import MjcfArm


def compiled() -> mujoco.MjModel:
    """Return the arm with the hand on its wrist."""
    folder = files("dm_control") / "third_party" / "kinova"
    arm, hand = (mujoco.MjSpec.from_file(str(folder / name)) for name in ("jaco_arm.xml", "jaco_hand.xml"))
    arm.attach(hand, site=arm.site("wristsite"), prefix="hand_")
    return arm.compile()


# Torques and speeds: datasheet of the actuators KA-75+ and KA-58, as in dm_control's jaco_arm.py.
JACO = MjcfArm(
    name="jaco",
    model=compiled,
    joints=("joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"),
    tool="hand_pinchsite",
    home_deg=(0.0, 180.0, 90.0, 0.0, 90.0, 0.0),
    torque_nm=(30.5, 30.5, 30.5, 6.8, 6.8, 6.8),
    speed_deg_s=(36.0, 36.0, 36.0, 48.0, 48.0, 48.0),
)
