"""Grippers: hands whose fingers hold objects by friction, one file each."""

from __future__ import annotations

from hrl_comfort.config import ConfigError, GripperConfig
from hrl_comfort.config.checks import part
from hrl_comfort.scene.grippers.gripper import Gripper, Hand
from hrl_comfort.scene.grippers.robotiq_2f85 import Robotiq2F85
from hrl_comfort.scene.grippers.two_finger import TwoFinger

GRIPPERS: dict[str, Gripper] = {each.name: each for each in (TwoFinger(), Robotiq2F85())}


def gripper_named(config: GripperConfig) -> Gripper:
    """Return the gripper of `config`: one of GRIPPERS, an entry point or `package.module:name`.

    Raises:
      ConfigError: there is none.
    """
    found = part("robot.gripper.name", config.name, GRIPPERS)
    if not all(hasattr(found, name) for name in ("name", "opening_m", "tip_m", "pads", "attach")):
        raise ConfigError(f"robot.gripper.name={config.name!r} is of type {type(found).__name__}; it must be a Gripper")
    return found


__all__ = ["GRIPPERS", "Gripper", "Hand", "Robotiq2F85", "TwoFinger", "gripper_named"]
