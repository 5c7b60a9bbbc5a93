"""Configuration of the shield between policy and arm, and of how cells differ from the model."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated

from hrl_comfort.config.cell import Pair
from hrl_comfort.config.checks import ConfigError, choice, within

Delay = Annotated[list[Annotated[float, within(0.0, 0.5)]], Pair]
Factor = Annotated[list[Annotated[float, within(0.5, 2.0)]], Pair]
Fraction = Annotated[list[Annotated[float, within(0.0, 0.9)]], Pair]
Noise = Annotated[list[Annotated[float, within(0.0, 100.0)]], Pair]
Rate = Annotated[list[Annotated[float, within(1.0, 50.0)]], Pair]


@dataclass(frozen=True)
class SafetyConfig:
    """Speed and separation monitoring; its guarantee and assumptions are in docs/safety.md."""

    kind: Annotated[str, choice("none", "ssm")]
    """`ssm` slows the arm so that the person cannot reach it while it is fast; `none` lets every action through."""
    bound: Annotated[str, choice("worst", "observed")]
    """Assumption about the person: `worst` lets them move at `human_speed_m_s` at any time, `observed` lets them speed
    up from their measured speed."""
    human_speed_m_s: Annotated[float, within(0.1, 5.0)]
    """Largest speed of any part of the person, m/s (ISO 13855: 1.6)."""
    human_acceleration_m_s2: Annotated[float, within(0.1, 100.0)]
    """`observed`: largest acceleration of any part of the person, m/s²."""
    safe_speed_m_s: Annotated[float, within(0.01, 1.0)]
    """Speed below which a moving arm may meet the person, m/s (ISO 10218-1: 0.25)."""
    delay_s: Annotated[float, within(0.0, 1.0)]
    """Age of the person's measured position, s."""
    lag_s: Annotated[float, within(0.0, 2.0)]
    """Lag of the servos behind a ramp of set-points, s."""
    latency_s: Annotated[float, within(0.0, 2.0)]
    """Time from a set-point until the servos have it, s. In `deploy` it is the time from sending a set-point until the
    resulting angles are measured, minus `lag_s`."""
    clearance_m: Annotated[float, within(0.001, 0.2)] | None
    """Distance that set-points of a rated arm keep from places, obstacles, the floor and the arm's own links, by
    braking in time, m; null: the arm may run into them."""
    margin_m: Annotated[float, within(0.0, 0.5)]
    """Largest error of the measured positions of person and arm, m."""


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
    object_mass: Factor
    """Factor of mass and inertia, drawn for each kind of object; with a gripper."""
    object_friction: Factor
    """Factor of sliding friction, drawn for each kind of object; with a gripper."""
    object_size: Factor
    """Factor of all sides, drawn for each kind of object, which keeps its mass; with a gripper."""
    person_noise_m: Annotated[list[Annotated[float, within(0.0, 0.5)]], Pair]
    """Standard deviation of the person's observed position along x and along y, m."""
    person_rate_hz: Rate
    """Frames of the person's tracker per second; the last frame holds until the next. 50 is one per control step."""
    person_dropout: Fraction
    """Probability that a frame is lost; at most two in a row are lost."""

    def __post_init__(self) -> None:
        for each in fields(self):
            low, high = getattr(self, each.name)
            if low > high:
                raise ConfigError(f"randomise.{each.name}=[{low:g}, {high:g}] is not [low, high]")

    def check_objects(self, holds: bool) -> None:
        """Raise ConfigError where objects differ and no hand `holds` them."""
        if self.objects and not holds:
            raise ConfigError(
                f"randomise.object_mass={self.object_mass}, object_friction={self.object_friction}, object_size="
                f"{self.object_size} are of objects that a hand holds; choose gripper=two_finger, or [1, 1] for each"
            )

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
    def resized(self) -> bool:
        """Whether objects have other sizes than the model's."""
        return self.object_size != [1, 1]

    @property
    def objects(self) -> bool:
        """Whether objects differ from the model's."""
        return self.resized or self.object_mass != [1, 1] or self.object_friction != [1, 1]

    @property
    def bodies(self) -> bool:
        """Whether the arm or objects differ from the model, so that each cell needs a model of its own."""
        return self.links or self.objects

    @property
    def differs(self) -> bool:
        """Whether any cell differs from the model."""
        return self.sensors or self.servos or self.tracker or self.bodies
