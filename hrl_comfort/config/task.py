"""What is to be done, and what it pays."""

from __future__ import annotations

from dataclasses import dataclass

from hrl_comfort.config.checks import ConfigError, between, one_of, point

COLOURS = ("random", "orange", "pink")
ACTIONS = ("joint", "cartesian")
POINTS = ("fixed", "random")
OBSERVATIONS = ("default", "paper")


@dataclass(frozen=True)
class PrecisionConfig:
    """How near counts as done."""

    grasp_tolerance_m: float
    place_tolerance_m: float
    home_tolerance_deg: float

    def __post_init__(self) -> None:
        between("task.precision.grasp_tolerance_m", self.grasp_tolerance_m, 0.005, 0.5)
        between("task.precision.place_tolerance_m", self.place_tolerance_m, 0.005, 0.5)
        between("task.precision.home_tolerance_deg", self.home_tolerance_deg, 0.1, 60.0)


@dataclass(frozen=True)
class TaskConfig:
    """One subtask (or a chain of them in one network) and its contract with the policy."""

    name: str
    colour: str
    balls: int
    """How many lie on the pick table; more than one are for `sort`."""
    ball_slots_m: list[list[float]]
    """Where they may lie, (x, y) from `cell.ball_m`; each ball of an episode has a slot of its own."""
    ball_jitter_m: float
    """A ball lies within this of its slot along x and y."""
    precision: PrecisionConfig
    max_episode_steps: int
    """Control steps of 20 ms after which an episode is truncated."""
    max_option_steps: int
    """Default of `meta_controller.time_limit_steps`, control steps."""
    action_repeat: int
    max_step_deg: float
    """Largest joint increment a control step."""
    max_step_m: float
    """`action=cartesian`: largest tool displacement a control step, each axis."""
    max_step_rot_deg: float
    """`action=cartesian`: largest tool rotation a control step, each axis."""
    action: str
    observation: str
    point: str
    """`reach`: the goal is `point_m`, or drawn at random for each episode."""
    point_m: list[float]
    second_point_m: list[float]
    """`point_to_point`: fixed second point."""
    start: str
    """Where place and return start: `ik`, or the path of recorded endings (.npz), replayed in motion."""
    resample_start_probability: float
    """Training: fraction of recorded starts with a person and a level drawn anew, not those recorded."""

    def __post_init__(self) -> None:
        one_of("task.colour", self.colour, COLOURS)
        for slot in self.ball_slots_m:
            point("task.ball_slots_m", slot, 2)
        between("task.ball_jitter_m", self.ball_jitter_m, 0.0, 0.1)
        if not 1 <= self.balls <= len(self.ball_slots_m):
            raise ConfigError(
                f"task.balls={self.balls} must be from 1 to {len(self.ball_slots_m)}, the task.ball_slots_m"
            )
        if self.balls > 1 and self.name != "sort":
            raise ConfigError(f"task.balls={self.balls}, but task.name={self.name} has one; choose sort")
        one_of("task.action", self.action, ACTIONS)
        one_of("task.observation", self.observation, OBSERVATIONS)
        one_of("task.point", self.point, POINTS)
        between("task.resample_start_probability", self.resample_start_probability, 0.0, 1.0)
        between("task.max_episode_steps", self.max_episode_steps, 1, 100_000)
        between("task.max_option_steps", self.max_option_steps, 1, 100_000)
        between("task.action_repeat", self.action_repeat, 1, 100)
        between("task.max_step_deg", self.max_step_deg, 0.01, 3.6)
        between("task.max_step_m", self.max_step_m, 0.001, 0.05)
        between("task.max_step_rot_deg", self.max_step_rot_deg, 0.01, 10.0)
        point("task.point_m", self.point_m, 3)
        point("task.second_point_m", self.second_point_m, 3)


@dataclass(frozen=True)
class RewardConfig:
    """Weight of each named reward term (see docs/tasks.md for their equations and units)."""

    progress: float
    home_progress: float
    pick: float
    place: float
    home: float
    reach: float
    arrival_speed: float
    """A rad/s of the joints' velocity (Euclidean norm) at the control step that completes a stage."""
    human_collision: float
    other_collision: float
    step: float
    overtime: float
    return_shaping: float
    k1: float
    """Eq. 1: k1, k2 and k3 multiply the bonuses of pick, place and return."""
    k2: float
    k3: float

    def __post_init__(self) -> None:
        for key, value in vars(self).items():
            between(f"reward.{key}", value, -1e4, 1e4)
