"""Arm, human and cell as one compiled MuJoCo model."""

from hrl_comfort.scene.human import LIMBS, build_human, limb_poses
from hrl_comfort.scene.mjcf_arm import MjcfArm
from hrl_comfort.scene.robots import ROBOTS, Robot
from hrl_comfort.scene.ur import TOOL_LENGTH_M, UrModel, build_robot
from hrl_comfort.scene.workcell import CONTROL_SPEC, Scene, build_scene

__all__ = [
    "CONTROL_SPEC", "LIMBS", "ROBOTS", "TOOL_LENGTH_M", "MjcfArm", "Robot",
    "Scene", "UrModel", "build_human", "build_robot", "build_scene", "limb_poses",
]  # fmt: skip
