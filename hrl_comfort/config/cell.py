"""Configuration of the robot, the cell and the simulation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from hrl_comfort.config.checks import check_fields, coordinates, point, within


@dataclass(frozen=True)
class RobotConfig:
    """The arm; its kinematics and masses are those of `scene.robots`."""

    name: str
    """A key of `scene.robots.ROBOTS`, an entry point or `package.module:name`, checked there."""
    home_deg: list[float] | None
    """Joint angles of the home pose, degrees; null is the arm's own."""

    def __post_init__(self) -> None:
        check_fields("robot", self)
        if self.home_deg is not None:
            point("robot.home_deg", self.home_deg, len(self.home_deg))


@dataclass(frozen=True)
class CellConfig:
    """Layout of the cell: metres, cell frame (robot base at the origin, z up)."""

    ball_m: Annotated[list[float], coordinates(3)]
    """Centre of the ball on the pick table, m."""
    orange_drop_m: Annotated[list[float], coordinates(3)]
    """Drop point of orange balls, m."""
    pink_drop_m: Annotated[list[float], coordinates(3)]
    """Drop point of pink balls, m."""
    ball_radius_m: Annotated[float, within(0.005, 0.2)]
    """Radius of a ball, m."""
    table_half_width_m: Annotated[float, within(0.02, 1.0)]
    """Half the side of each square table, m."""
    base_height_m: Annotated[float, within(0.0, 2.0)]
    """Height of the robot's base above the floor, m."""

    def __post_init__(self) -> None:
        check_fields("cell", self)


@dataclass(frozen=True)
class EngineConfig:
    """The batched simulation."""

    num_envs: Annotated[int, within(1, 65536)]
    """Number of cells."""
    threads: Annotated[int, within(1, 256)]
    """Threads of the simulation."""
    substeps: Annotated[int, within(1, 100)]
    """Physics steps a control step of 20 ms."""

    def __post_init__(self) -> None:
        check_fields("engine", self)
