"""Configuration of the robot, the cell, the simulation, how cells differ, and the connection to a real arm."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated

from pydantic import Field

from hrl_comfort.config.checks import XYZ, ConfigError, Coordinate, choice, within
from hrl_comfort.config.constants import MAX_ENVS

Pair = Field(min_length=2, max_length=2)
Delay = Annotated[list[Annotated[float, within(0.0, 0.5)]], Pair]
Factor = Annotated[list[Annotated[float, within(0.5, 2.0)]], Pair]
Fraction = Annotated[list[Annotated[float, within(0.0, 0.9)]], Pair]
Noise = Annotated[list[Annotated[float, within(0.0, 100.0)]], Pair]
Rate = Annotated[list[Annotated[float, within(1.0, 50.0)]], Pair]


@dataclass(frozen=True)
class RobotConfig:
    """The arm; its kinematics and masses are those of `scene.robots`."""

    name: str
    """A built-in robot, a robot that an installed package offers as an entry point (both by name), or
    `package.module:name`."""
    home_deg: list[Coordinate] | None
    """Joint angles of the home pose, degrees; null is the arm's own."""
    rating: Annotated[str, choice("collaborative", "full", "paper")]
    """Limits of joint speed, of joint acceleration and of the speed of the arm's fastest point. The limits of joint
    speed in `full` and `collaborative` are the datasheet's. `full`: the joint acceleration that the arm can reach
    (estimated from the stopping times in UR's manuals), the fastest point up to 1.5 m/s. `collaborative`: half that
    acceleration, the fastest point up to 1 m/s. `full` and `collaborative` exist for UR arms alone. `paper`: no limit
    but `task.max_step_deg`."""
    calibration: str | None = None
    """The file calibration.conf from the controller of a Universal Robots arm; null takes the nominal arm of the
    model."""


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
    """Number of cells that are simulated at once."""
    threads: Annotated[int, within(1, 256)]
    """Threads of the simulation."""
    substeps: Annotated[int, within(1, 100)]
    """Physics steps in a control step of 20 ms."""


@dataclass(frozen=True)
class ConnectionConfig:
    """The arm that a deployment moves."""

    name: Annotated[str, choice("simulated", "ur")]
    """`simulated`: an arm in MuJoCo that runs in real time. `ur`: a robot of Universal Robots, by RTDE."""
    host: str
    """`ur`: address of the robot's controller."""
    frame_m: Annotated[list[XYZ], Field(min_length=3, max_length=3)] | None
    """Frame in which `cell.*_m`, `task.*point_m` and live positions of people are given; null: that of the robot's
    base. For another frame give three tool positions, measured in the frame of the base, m: the new frame's origin, a
    point on its x axis, and a point in its x-y plane with y > 0."""


@dataclass(frozen=True)
class RandomiseConfig:
    """Ranges [low, high] from which each episode draws how its cell differs from the model, uniformly.

    Equal ends fix a value. Noise is normal, cut off at three standard deviations.
    """

    servo_lag_s: Delay
    """Lag of the servos behind a ramp of set-points, s, in addition to the model's 0.03 s."""
    latency_s: Delay
    """Time from a set-point until the servos have it, s."""
    link_mass: Factor
    """Factor of mass and inertia, drawn for each link."""
    joint_friction: Fraction
    """Coulomb friction as a share of the largest torque, drawn for each joint."""
    joint_noise_deg: Noise
    """Standard deviation of the observed joint angles, degrees. The observed position of the tool is computed from the
    noisy angles."""
    joint_velocity_noise_deg_s: Noise
    """Standard deviation of observed joint velocities, degrees/s."""
    person_noise_m: Annotated[list[Annotated[float, within(0.0, 0.5)]], Pair]
    """Standard deviation of the person's observed position along x and along y, m."""
    person_rate_hz: Rate
    """Frames of the person's tracker per second; the last frame holds until the next. 50 is one per control step."""
    person_dropout: Fraction
    """Probability that a frame is lost; at most two in a row are lost."""

    def __post_init__(self) -> None:
        for field in fields(self):
            low, high = getattr(self, field.name)
            if low > high:
                raise ConfigError(f"randomise.{field.name}=[{low:g}, {high:g}] is not [low, high]")

    @property
    def sensors(self) -> bool:
        """Whether joints are observed with noise."""
        return max(self.joint_noise_deg[1], self.joint_velocity_noise_deg_s[1]) > 0

    @property
    def servos(self) -> bool:
        """Whether set-points reach the servos late."""
        return max(self.servo_lag_s[1], self.latency_s[1]) > 0

    @property
    def tracker(self) -> bool:
        """Whether the person is observed late or with noise."""
        return max(self.person_noise_m[1], self.person_dropout[1]) > 0 or self.person_rate_hz[0] < 50

    @property
    def links(self) -> bool:
        """Whether the arm differs from the model."""
        return self.link_mass != [1, 1] or self.joint_friction[1] > 0

    @property
    def differs(self) -> bool:
        """Whether any cell differs from the model."""
        return self.sensors or self.servos or self.tracker or self.links
