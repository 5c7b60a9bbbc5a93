"""Franka Emika Panda with its hand, from the kitchen of gymnasium-robotics, of which only the files are needed."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import mujoco

from hrl_comfort.config import ConfigError
from hrl_comfort.scene.mjcf_arm import MjcfArm

MODEL = """
<mujoco model="franka">
  <include file="{folder}/assets.xml"/>
  <compiler meshdir="{folder}/meshes"/>
  <worldbody><include file="{folder}/chain.xml"/></worldbody>
</mujoco>
"""
FINGER_Y_M, FINGER_Z_M, FINGER_RADIUS_M = 0.010, (0.015, 0.083), 0.012
"""Capsule of a closed finger in its own frame: offset of its axis, ends of the axis, radius."""


def compiled() -> mujoco.MjModel:
    """Return the arm; raise ConfigError where gymnasium-robotics is not installed."""
    package = find_spec("gymnasium_robotics")
    places = [] if package is None else list(package.submodule_search_locations or ())
    for place in places:
        folder = Path(place) / "envs" / "assets" / "kitchen_franka" / "franka_assets"
        if folder.is_dir():
            return _with_plain_fingers(mujoco.MjSpec.from_string(MODEL.format(folder=folder))).compile()
    raise ConfigError(
        "robot.name='franka' needs the files of gymnasium-robotics: pip install --no-deps gymnasium-robotics==1.4.2"
    )


def _with_plain_fingers(arm: mujoco.MjSpec) -> mujoco.MjSpec:
    """Return the arm with one capsule a finger in place of the 13 shapes that suit grasping."""
    for name, side in (("panda0_leftfinger", 1.0), ("panda0_rightfinger", -1.0)):
        finger = arm.body(name)
        for shape in list(finger.geoms):
            if shape.type != mujoco.mjtGeom.mjGEOM_MESH:
                arm.delete(shape)
        y = side * FINGER_Y_M
        ends = [0.0, y, FINGER_Z_M[0], 0.0, y, FINGER_Z_M[1]]
        finger.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=ends, size=[FINGER_RADIUS_M, 0, 0])
    return arm


# Torques and speeds: the file's actuator.xml, from the control parameters that Franka Emika publishes.
FRANKA = MjcfArm(
    name="franka",
    model=compiled,
    joints=tuple(f"robot:panda0_joint{number}" for number in range(1, 8)),
    tool="end_effector",
    home_deg=(0.0, -45.0, 0.0, -135.0, 0.0, 0.0, 0.0),
    torque_nm=(87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0),
    speed_deg_s=(124.6, 124.6, 124.6, 124.6, 149.5, 149.5, 149.5),
    mount_deg=90.0,  # its first joint turns by 166 degrees each way: the ball would be where it cannot point
)
