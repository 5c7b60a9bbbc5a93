"""The robot, the cell and its simulation."""

from __future__ import annotations

from dataclasses import dataclass

from hrl_comfort.config.checks import between, point


@dataclass(frozen=True)
class RobotConfig:
    """Which arm stands in the cell. Its kinematics and masses are constants of `scene.robots`."""

    name: str
    """A key of `scene.robots.ROBOTS`, which checks it."""
    home_deg: list[float]
    """Joint angles at the start and after `return`, one per joint, degrees."""

    def __post_init__(self) -> None:
        point("robot.home_deg", self.home_deg, 6)


@dataclass(frozen=True)
class CellConfig:
    """Where things stand; metres, cell frame: robot base at the origin, z up."""

    ball_m: list[float]
    orange_drop_m: list[float]
    pink_drop_m: list[float]
    ball_radius_m: float
    table_half_width_m: float
    base_height_m: float
    """Height of the robot's base above the floor the human walks on."""

    def __post_init__(self) -> None:
        for key in ("ball_m", "orange_drop_m", "pink_drop_m"):
            point(f"cell.{key}", getattr(self, key), 3)
        between("cell.ball_radius_m", self.ball_radius_m, 0.005, 0.2)
        between("cell.table_half_width_m", self.table_half_width_m, 0.02, 1.0)
        between("cell.base_height_m", self.base_height_m, 0.0, 2.0)


@dataclass(frozen=True)
class EngineConfig:
    """The batched simulation."""

    num_envs: int
    threads: int
    substeps: int
    """Physics steps a control step of 20 ms."""

    def __post_init__(self) -> None:
        between("engine.num_envs", self.num_envs, 1, 65536)
        between("engine.threads", self.threads, 1, 256)
        between("engine.substeps", self.substeps, 1, 100)
