"""A gripper as the cell takes it, and as the end effector of an arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from dm_control import mjcf

from hrl_comfort.config import ConfigError

DRIVE = "hand"
"""Name of a gripper's actuator."""
PEOPLE = 2
"""Bit (contype) of the contacts of shapes that touch people alone."""


class Gripper(Protocol):
    """A hand with fingers on two sides of the tool, which one drive opens and closes."""

    @property
    def name(self) -> str:
        """Value of `robot.gripper.name`."""

    @property
    def opening_m(self) -> float:
        """Distance of the pads of the open hand, m."""

    @property
    def tip_m(self) -> float:
        """Reach of the fingertips beyond the tool centre point, in any direction, m."""

    @property
    def pads(self) -> tuple[str, str]:
        """Names of the bodies, one on each side, that touch what is held."""

    def attach(self, flange: mjcf.Element, force_n: float) -> None:
        """Add bodies to the last link, whose frame is the flange's with z outwards, and the drive to `flange.root`.

        The site `tcp` is in the middle between the pads, z away from the flange, x from one pad to the other. The drive
        is a position servo named DRIVE with at most `force_n` N, whose control runs from open to closed. Capsules and
        spheres count for the shield where they are in the open hand. Pads collide; fingers do not touch each other.
        """


@dataclass(frozen=True)
class Hand:
    """A gripper with the force of its drive, as the end effector of an arm (`scene.ur.EndEffector`)."""

    gripper: Gripper
    force_n: float

    @property
    def name(self) -> str:
        """Name of the gripper."""
        return self.gripper.name

    def attach(self, flange: mjcf.Element) -> None:
        """See `EndEffector`.

        Raises:
          ConfigError: the gripper cannot be attached, or lacks what every gripper adds.
        """
        try:
            self.gripper.attach(flange, self.force_n)
        except Exception as error:  # a user's own code
            raise ConfigError(f"{self._said}: attach() raised {type(error).__name__}: {error}") from error
        root, pads = flange.root, tuple(self.gripper.pads)
        wanted = [("actuator", DRIVE), ("site", "tcp"), *(("body", pad) for pad in pads)]
        lacks = [f"{kind} {name!r}" for kind, name in wanted if root.find(kind, name) is None]
        if lacks or len(pads) != 2:
            raise ConfigError(
                f"{self._said}: attach() must add two pads, the site 'tcp' and the actuator {DRIVE!r}; "
                f"pads={list(pads)}, and it lacks {', '.join(lacks) or 'nothing else'}"
            )
        if root.find("actuator", DRIVE).ctrlrange is None:
            raise ConfigError(
                f"{self._said}: the actuator {DRIVE!r} has no ctrlrange, from open to closed; give it one"
            )

    @property
    def _said(self) -> str:
        return f"robot.gripper.name={self.name}"
