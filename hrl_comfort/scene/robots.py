"""Robots by name, and what the cell takes from one."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

from dm_control import mjcf

from hrl_comfort.config import ConfigError, GripperConfig
from hrl_comfort.config.checks import part
from hrl_comfort.scene.franka import FRANKA
from hrl_comfort.scene.grippers import Hand, gripper_named
from hrl_comfort.scene.jaco import JACO
from hrl_comfort.scene.ur import UR_ARMS, EndEffector, TwoFingers, UrModel


class Robot(Protocol):
    """A serial arm of J hinges on a fixed base."""

    @property
    def name(self) -> str:
        """Value of `robot.name`."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the J joints and of their position servos in the built model, base first."""

    @property
    def home_deg(self) -> tuple[float, ...]:
        """(J,) joint angles of the home pose, degrees."""

    @property
    def speed_deg_s(self) -> tuple[float, ...]:
        """(J,) rated joint speeds, degrees/s."""

    def build(self) -> mjcf.RootElement:
        """Return the model `robot`: joints, servos that take rad, capsules as geoms, the site `tcp` at the tool.

        The origin is that of the cell, on the pedestal. Nothing else in it moves.

        Raises:
          ConfigError: a file of the model is not there, or it is no such arm.
        """


END_EFFECTORS: dict[str, EndEffector] = {each.name: each for each in (TwoFingers(),)}
ROBOTS: dict[str, Robot] = {**UR_ARMS, JACO.name: JACO, FRANKA.name: FRANKA}


def robot_named(name: str) -> Robot:
    """Return the robot `name`: one of ROBOTS, an entry point or `package.module:name`.

    Raises:
      ConfigError: there is none.
    """
    found = part("robot.name", name, ROBOTS)
    if not (hasattr(found, "build") and hasattr(found, "joints")):
        raise ConfigError(f"robot.name={name!r} is of type {type(found).__name__}; it must be a Robot, such as MjcfArm")
    return found


def equipped(name: str, end_effector: str | None, gripper: GripperConfig) -> Robot:
    """Return the robot `name` with its end effector or gripper; raise ConfigError as `with_end_effector` does."""
    arm = robot_named(name)
    if not gripper.holds:
        return with_end_effector(arm, end_effector)
    if not isinstance(arm, UrModel):
        raise ConfigError(
            f"robot.gripper.name={gripper.name}: robot.name={arm.name} has its own hand; choose gripper=none, or a UR "
            "arm"
        )
    return replace(arm, end_effector=Hand(gripper_named(gripper), gripper.force_n))


def with_end_effector(arm: Robot, name: str | None) -> Robot:
    """Return an arm with the end effector `name`: one of END_EFFECTORS, an entry point or `package.module:name`.

    None is the arm's own: `rg2` of Universal Robots' arms, what the file holds of others.

    Raises:
      ConfigError: there is none, or the arm has one of its own.
    """
    if name is None:
        return arm
    found = part("robot.end_effector", name, END_EFFECTORS)
    if not hasattr(found, "attach"):
        raise ConfigError(f"robot.end_effector={name!r} is of type {type(found).__name__}; it must be an EndEffector")
    if not isinstance(arm, UrModel):
        raise ConfigError(
            f"robot.end_effector={name}: robot.name={arm.name} has its own; leave it null, or choose a UR arm"
        )
    return replace(arm, end_effector=found)
