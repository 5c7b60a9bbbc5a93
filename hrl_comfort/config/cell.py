"""Configuration of the robot, the cell, the simulation, and the connection to a real arm."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from pydantic import Field

from hrl_comfort.config.checks import XY, XYZ, ConfigError, Coordinate, Name, choice, choice_of, one_of, within
from hrl_comfort.config.constants import MAX_ENVS

Pair = Field(min_length=2, max_length=2)
Rgb = Annotated[list[Annotated[float, within(0.0, 1.0)]], Field(min_length=3, max_length=3)]
Sizes = Annotated[list[Annotated[float, within(0.001, 5.0)]], Field(min_length=1, max_length=3)]
SIZES = {"sphere": 1, "box": 3, "cylinder": 2, "capsule": 2}
"""Numbers that the size of a shape has."""
SHAPES = tuple(SIZES)
DIGITS = 12
"""Decimals to which the sum of two heights is rounded: 0.257 + 0.03 is 0.287."""


@dataclass(frozen=True)
class GripperConfig:
    """Hand of a Universal Robots arm that holds objects by friction; the group `gripper` chooses it."""

    name: str = "none"
    """`none`: a picked object rides on the tool without mass. Otherwise objects are bodies with mass and friction:
    `two_finger`, `robotiq_2f85`, a gripper that an installed package offers as an entry point, or
    `package.module:name`."""
    force_n: Annotated[float, within(1.0, 500.0)] = 40.0
    """Largest force of the drive that closes the fingers, N."""

    @property
    def holds(self) -> bool:
        """Whether objects are held by friction."""
        return self.name != "none"


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
    end_effector: str | None = None
    """End effector of a Universal Robots arm: `rg2`, one that an installed package offers as an entry point,
    or `package.module:name`; null: `rg2`. Other arms have that of their file."""
    gripper: GripperConfig = field(default_factory=GripperConfig)
    """Hand that holds objects, in the place of an end effector."""

    def __post_init__(self) -> None:
        if self.gripper.holds and self.end_effector is not None:
            raise ConfigError(
                f"robot.end_effector={self.end_effector} and robot.gripper.name={self.gripper.name} are both at the "
                "flange; leave robot.end_effector null, or choose gripper=none"
            )


def half_height(shape: str, size_m: list[float]) -> float:
    """Return half the height of an upright shape, m."""
    return size_m[-1] if shape != "capsule" else size_m[0] + size_m[1]


@dataclass(frozen=True)
class PlaceConfig:
    """A horizontal surface on which objects lie: a table, a tray, a shelf, a part of a larger table."""

    top_m: XYZ
    """Middle of the surface, m."""
    size_m: Annotated[list[Annotated[float, within(0.02, 4.0)]], Pair]
    """Sides of the surface, x and y of its own frame, m."""
    yaw_deg: Coordinate = 0.0
    """Turn of the surface about the vertical, degrees."""
    slots_m: Annotated[list[XY], Field(min_length=1)] = field(default_factory=lambda: [[0.0, 0.0]])
    """Positions of several objects: (x, y) from the middle, in the surface's frame, m. One object alone lies
    in the middle."""
    legs: Annotated[int, choice_of(0, 1, 4)] = 1
    """Legs down to the floor: one in the middle, four at the corners, or none for a place that something else
    carries."""


@dataclass(frozen=True)
class ObjectConfig:
    """A kind of object: what it is like, where it arrives and where it belongs."""

    shape: Annotated[str, choice(*SHAPES)]
    """`sphere`, `box`, `cylinder` or `capsule`; the last two stand upright."""
    size_m: Sizes
    """`sphere`: radius. `box`: half its sides. `cylinder`, `capsule`: radius, and half the length of the straight part.
    Metres."""
    arrives_at: str
    """Name of the place where it is picked."""
    belongs_at: str
    """Name of the place where it is put down."""
    mass_kg: Annotated[float, within(0.001, 50.0)] = 0.05
    """Mass, kg. It counts with a gripper: without one, a picked object rides on the tool without mass."""
    friction: Annotated[float, within(0.05, 5.0)] = 1.0
    """Coefficient of sliding friction of all its contacts; it counts with a gripper."""
    rgb: Rgb = field(default_factory=lambda: [0.3, 0.5, 0.8])
    """Colour in pictures: red, green and blue, 0 to 1."""

    @property
    def half_height_m(self) -> float:
        """Height of its centre above what it lies on, m."""
        return half_height(self.shape, self.size_m)

    @property
    def half_width_m(self) -> float:
        """Largest horizontal distance from its centre, along x or y, m."""
        return max(self.size_m[:2]) if self.shape == "box" else self.size_m[0]

    @property
    def half_m(self) -> list[float]:
        """Half its sides along x, y and z, upright, m."""
        return self.size_m if self.shape == "box" else [self.size_m[0], self.size_m[0], self.half_height_m]


@dataclass(frozen=True)
class ObstacleConfig:
    """A solid that stands still; the arm must not touch it."""

    shape: Annotated[str, choice(*SHAPES[1:])]
    """`box`, `cylinder` or `capsule`; the last two stand upright."""
    position_m: XYZ
    """Its centre, m."""
    size_m: Sizes
    """As of an object."""
    yaw_deg: Coordinate = 0.0
    """Turn about the vertical, degrees."""
    rgb: Rgb = field(default_factory=lambda: [0.55, 0.57, 0.6])
    """Colour in pictures: red, green and blue, 0 to 1."""

    @property
    def half_height_m(self) -> float:
        """Height of its top above its centre, m."""
        return half_height(self.shape, self.size_m)


@dataclass(frozen=True)
class VaryConfig:
    """Ranges [low, high] from which the layouts of a cell are drawn, uniformly."""

    layouts: Annotated[int, within(0, 100_000)] = 0
    """Number of layouts in each split; `train`, `validation` and `test` have none in common. 0: the layout is always
    the one given."""
    distance_m: XY = field(default_factory=lambda: [0.38, 0.68])
    """Horizontal distance of the middle of a place from the robot's base, m. Its bearing may be any. A box that carries
    all places, which have no legs, stays where it is, and all else is above it."""
    height_m: XY = field(default_factory=lambda: [0.0, 0.42])
    """Height of a place's top above the robot's base, m."""
    apart_m: Annotated[float, within(0.0, 2.0)] = 0.3
    """Smallest horizontal distance between the middles of two places, and of a place and an obstacle, m."""
    home_deg: Annotated[float, within(0.0, 45.0)] = 10.0
    """Largest difference of each joint's home angle from that of `robot.home_deg`, degrees."""
    obstacle_probability: Annotated[float, within(0.0, 1.0)] = 0.5
    """Probability that an obstacle is there; it stands at a distance in `distance_m`, as high as configured."""

    def __post_init__(self) -> None:
        for name in ("distance_m", "height_m"):
            low, high = getattr(self, name)
            if low > high:
                raise ConfigError(f"cell.vary.{name}=[{low:g}, {high:g}] is not [low, high]")


@dataclass(frozen=True)
class CellConfig:
    """A cell: what stands round the robot, and the objects in it.

    Metres, cell frame (robot base at the origin, z up).
    """

    places: Annotated[dict[Name, PlaceConfig], Field(min_length=1)]
    """Surfaces on which objects lie, by name."""
    objects: Annotated[dict[Name, ObjectConfig], Field(min_length=1)]
    """Kinds of objects, by name."""
    base_height_m: Annotated[float, within(0.0, 2.0)]
    """Height of the robot's base above the floor, m."""
    obstacles: dict[Name, ObstacleConfig] = field(default_factory=dict)
    """Further solids that the arm must not touch, by name."""
    stations_m: Annotated[list[XY], Field(min_length=1)] | None = None
    """Stations of people who work there, (x, y), m; null: 0.4 m behind each place, as seen from the robot."""
    vary: VaryConfig = field(default_factory=VaryConfig)
    """Differences of the layout from one episode to another."""

    def __post_init__(self) -> None:
        for section in ("objects", "obstacles"):
            for name, each in getattr(self, section).items():
                if len(each.size_m) != (count := SIZES[each.shape]):
                    raise ConfigError(
                        f"cell.{section}.{name}.size_m={each.size_m} has {len(each.size_m)} numbers; "
                        f"shape={each.shape} takes {count}"
                    )
        for name, each in self.objects.items():
            one_of(f"cell.objects.{name}.arrives_at", each.arrives_at, tuple(self.places))
            one_of(f"cell.objects.{name}.belongs_at", each.belongs_at, tuple(self.places))

    def __hash__(self) -> int:
        return hash(repr(self))

    @property
    def kinds(self) -> tuple[str, ...]:
        """Names of the kinds of objects, by their number."""
        return tuple(self.objects)

    def centre(self, kind: str, place: str) -> list[float]:
        """Return where the centre (3,) m of an object of a kind is that lies in the middle of a place."""
        x, y, top = self.places[place].top_m
        return [x, y, round(top + self.objects[kind].half_height_m, DIGITS)]

    @property
    def goals(self) -> dict[str, list[float]]:
        """Goal (3,) m of the tool at each place: the centre of the first kind that arrives or belongs there.

        The middle of a place where nothing does.
        """
        found = {name: place.top_m for name, place in self.places.items()}
        for end in ("belongs_at", "arrives_at"):
            for kind, each in reversed(self.objects.items()):
                found[getattr(each, end)] = self.centre(kind, getattr(each, end))
        return found


@dataclass(frozen=True)
class EngineConfig:
    """The batched simulation."""

    num_envs: Annotated[int, within(1, MAX_ENVS)]
    """Number of cells that are simulated at once."""
    threads: Annotated[int, within(1, 256)]
    """Threads of the simulation, in each process."""
    processes: Annotated[int, within(1, 256)]
    """Processes that share the cells out, at most one for each cell; the episodes are the same, bit for bit. For a
    hundred cells or more and free cores."""
    substeps: Annotated[int, within(1, 100)]
    """Physics steps in a control step of 20 ms; with a gripper at least 4, which a grasp needs."""


@dataclass(frozen=True)
class ConnectionConfig:
    """The arm that a deployment moves."""

    name: Annotated[str, choice("simulated", "ur")]
    """`simulated`: an arm in MuJoCo that runs in real time. `ur`: a robot of Universal Robots, by RTDE."""
    host: str
    """`ur`: address of the robot's controller."""
    gripper: Annotated[str, choice("none", "robotiq", "tool_output")]
    """`ur`: connection of the hand that `robot.gripper` describes. `robotiq`: a 2F-85, by the server of Robotiq's URCap
    on port 63352 of `host`. `tool_output`: a hand of two states on the tool connector: digital output 0 closes it,
    digital input 0 is on while it grips. The simulated arm has the fingers of its model, and takes `none`."""
    frame_m: Annotated[list[XYZ], Field(min_length=3, max_length=3)] | None
    """Frame in which places and obstacles of `cell`, `task.*point_m` and live positions of people are given; null:
    that of the robot's base. For another frame give three tool positions, measured in the frame of the base, m: the new
    frame's origin, a point on its x axis, and a point in its x-y plane with y > 0."""

    def check_moves(self, hand: GripperConfig) -> None:
        """Raise ConfigError if the connection does not move this hand."""
        wired = hand.holds and self.name == "ur"
        allowed = (
            ("none",) if not wired else ("robotiq", "tool_output") if hand.name == "robotiq_2f85" else ("tool_output",)
        )
        if self.gripper not in allowed:
            raise ConfigError(
                f"connection.gripper={self.gripper} does not go with connection={self.name} and robot.gripper.name="
                f"{hand.name}; choose connection.gripper={' or '.join(allowed)}"
            )
