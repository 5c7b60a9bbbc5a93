"""Configuration of the robot, the cell, the simulation and the connection to a real arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from hrl_comfort.config.checks import XYZ, Coordinate, choice, within
from hrl_comfort.config.constants import MAX_ENVS


@dataclass(frozen=True)
class RobotConfig:
    """The arm; its kinematics and masses are those of `scene.robots`."""

    name: str
    """A key of `scene.robots.ROBOTS`, an entry point or `package.module:name`, checked there."""
    home_deg: list[Coordinate] | None
    """Joint angles of the home pose, degrees; null is the arm's own."""
    rating: Annotated[str, choice("collaborative", "full", "paper")]
    """Limits of `scene.ratings` on set-points; `paper` has none but `task.max_step_deg`."""
    calibration: str | None = None
    """The controller's file calibration.conf of an arm of Universal Robots; null is the model's nominal arm."""


@dataclass(frozen=True)
class CellConfig:
    """Layout of the cell: metres, cell frame (robot base at the origin, z up)."""

    ball_m: XYZ
    """Centre of the ball on the pick table, m."""
    orange_drop_m: XYZ
    """Drop point of orange balls, m."""
    pink_drop_m: XYZ
    """Drop point of pink balls, m."""
    ball_radius_m: Annotated[float, within(0.005, 0.2)]
    """Radius of a ball, m."""
    table_half_width_m: Annotated[float, within(0.02, 1.0)]
    """Half the side of each square table, m."""
    base_height_m: Annotated[float, within(0.0, 2.0)]
    """Height of the robot's base above the floor, m."""


@dataclass(frozen=True)
class EngineConfig:
    """The batched simulation."""

    num_envs: Annotated[int, within(1, MAX_ENVS)]
    """Number of cells."""
    threads: Annotated[int, within(1, 256)]
    """Threads of the simulation."""
    substeps: Annotated[int, within(1, 100)]
    """Physics steps a control step of 20 ms."""


@dataclass(frozen=True)
class ConnectionConfig:
    """The arm that a deployment moves."""

    name: Annotated[str, choice("simulated", "ur")]
    """`simulated`: an arm in MuJoCo that keeps the wall clock. `ur`: a robot of Universal Robots, by RTDE."""
    host: str
    """`ur`: address of the robot's controller."""
    frame_m: Annotated[list[XYZ], Field(min_length=3, max_length=3)] | None
    """Three places of the tool in the frame of the robot's base, m: the origin of the frame in which `cell.*_m`,
    `task.*point_m` and live positions of people are given, a point on its x axis, and one where y > 0; null is the
    frame of the base."""
