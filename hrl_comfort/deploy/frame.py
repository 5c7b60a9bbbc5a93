"""The cell's frame in that of the robot's base, by three points that the tool was taken to."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import ConfigError, DeployConfig
from hrl_comfort.humans.motions.live import Pose

Array = NDArray[np.float64]
NEAREST_M = 0.1
"""Smallest distance of the points from the origin, and of the third one from the x axis."""
STEEPEST_RAD = math.radians(2.0)
"""Largest tilt: floor and gravity of the model are those of the robot's base."""


@dataclass(frozen=True)
class Frame:
    """A right-handed frame."""

    origin: Array
    """(3,) m, base frame."""
    axes: Array
    """(3, 3) unit vectors x, y, z as columns, base frame."""

    @classmethod
    def taught(cls, points: list[list[float]]) -> Frame:
        """Return the frame of three points (3, 3) m: its origin, one on x, one in the plane of x and y where y > 0.

        Raises:
          ConfigError: the points are too close to tell the axes, or the frame does not stand upright.
        """
        origin, on_x, in_plane = np.array(points)
        x, other = on_x - origin, in_plane - origin
        z = np.cross(x, other)
        if min(length := float(np.linalg.norm(x)), float(np.linalg.norm(z)) / max(length, 1e-9)) < NEAREST_M:
            raise ConfigError(
                f"connection.frame_m={points}: the second point must be {NEAREST_M:g} m or more from the first, "
                "and the third as far from the line through both"
            )
        x, z = x / length, z / np.linalg.norm(z)
        if (tilt := math.acos(min(1.0, max(-1.0, z[2])))) > STEEPEST_RAD:
            raise ConfigError(
                f"connection.frame_m={points}: z is {math.degrees(tilt):.3g} degrees off that of the robot's base, at "
                f"most {math.degrees(STEEPEST_RAD):g} are allowed; the third point belongs on the side of positive y"
            )
        return cls(origin, np.stack([x, np.cross(z, x), z], axis=1))

    def point(self, point: list[float]) -> list[float]:
        """Return a point (3,) m of this frame in the base frame."""
        found: list[float] = (self.origin + self.axes @ point).tolist()
        return found

    def pose(self, pose: Pose) -> Pose:
        """Return a person's pose of this frame in the base frame."""
        x, y, yaw = pose
        at = self.point([x, y, 0.0])
        return at[0], at[1], None if yaw is None else yaw + math.atan2(self.axes[1, 0], self.axes[0, 0])

    def places(self, config: DeployConfig) -> DeployConfig:
        """Return `config` with its places, obstacles and points, of this frame, in the base frame."""
        cell, task, turn = config.cell, config.task, math.degrees(math.atan2(self.axes[1, 0], self.axes[0, 0]))
        places = {
            name: replace(each, top_m=self.point(each.top_m), yaw_deg=each.yaw_deg + turn)
            for name, each in cell.places.items()
        }
        obstacles = {
            name: replace(each, position_m=self.point(each.position_m), yaw_deg=each.yaw_deg + turn)
            for name, each in cell.obstacles.items()
        }
        return replace(
            config,
            cell=replace(cell, places=places, obstacles=obstacles),
            task=replace(task, point_m=self.point(task.point_m), second_point_m=self.point(task.second_point_m)),
            connection=replace(config.connection, frame_m=None),
        )
