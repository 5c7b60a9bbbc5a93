"""Configuration of the subtask and its reward."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from hrl_comfort.config.cell import CellConfig
from hrl_comfort.config.checks import XYZ, ConfigError, choice, one_of, within

OBSERVATIONS = ("default", "set_points", "sight", "paper")
SORTING = ("sort", "shift", "kitting")
"""Tasks of several objects."""
RANDOM = "random"
"""Value of `task.object`: any kind of the cell's."""


@dataclass(frozen=True)
class PrecisionConfig:
    """Tolerances of the stages."""

    grasp_tolerance_m: Annotated[float, within(0.005, 0.5)]
    """Distance of the tool from its goal at which a stage of `pick`, `reach` or `point_to_point` is done, m."""
    place_tolerance_m: Annotated[float, within(0.005, 0.5)]
    """Distance of the tool from the goal at which `place` is done, m."""
    home_tolerance_deg: Annotated[float, within(0.1, 60.0)]
    """Largest joint error at which `return` is done, degrees."""


@dataclass(frozen=True)
class TaskConfig:
    """A subtask, or a chain of subtasks for one policy."""

    name: str
    """A built-in subtask, a subtask that an installed package offers as an entry point (both by name), or
    `package.module:name`."""
    object: str
    """Kind of the objects: a name of `cell.objects`, or `random` for any of them."""
    objects: Annotated[int, within(1, 64)]
    """Number of objects to be picked; above 1 for `sort`, `shift` and `kitting` only. Each has a slot of its own
    (`cell.places.NAME.slots_m`). `kitting` has one of each kind."""
    object_jitter_m: Annotated[float, within(0.0, 0.1)]
    """Largest offset of an object from its slot along x and along y, m."""
    due_s: Annotated[list[Annotated[float, within(1.0, 3600.0)]], Field(min_length=2, max_length=2)]
    """`kitting`: shortest and longest time from the opening of an order until it is due, s."""
    precision: PrecisionConfig
    max_episode_steps: Annotated[int, within(1, 100_000)]
    """Control steps of 20 ms after which an episode is out of time. If `comfort.source` is not `none` and
    `comfort.beta` is above 0, the limit is multiplied by `comfort.levels` / level (not in `shift`)."""
    max_option_steps: Annotated[int, within(1, 100_000)]
    """Control steps after which an option of a chain is preempted, unless `meta_controller.time_limit_steps` is set.
    The default is 500, and 400 for `sort`, `shift` and `kitting`. If `comfort.source` is not `none` and `comfort.beta`
    is above 0, the limit is multiplied by `comfort.levels` / level."""
    action_repeat: Annotated[int, within(1, 100)]
    """Control steps in a decision, which is one call of the policy."""
    max_step_deg: Annotated[float, within(0.01, 3.6)]
    """Largest joint increment in one control step, degrees."""
    max_step_m: Annotated[float, within(0.001, 0.05)]
    """`action=cartesian`: largest tool displacement in one control step, on each axis, m."""
    max_step_rot_deg: Annotated[float, within(0.01, 10.0)]
    """`action=cartesian`: largest tool rotation in one control step, on each axis, degrees."""
    action: Annotated[str, choice("joint", "cartesian")]
    """Command of a policy: joint increments, or displacements and rotations of the tool."""
    observation: Annotated[str, choice(*OBSERVATIONS)]
    """Layout of the observation, defined in `tasks.observations`."""
    point: Annotated[str, choice("fixed", "random")]
    """`reach`, `point_to_point`: goals are the fixed points below, or random in each episode."""
    point_m: XYZ
    """`reach`, `point_to_point`: the fixed (first) point, m."""
    second_point_m: XYZ
    """`point_to_point`: the fixed second point, m."""
    start: str
    """Starts of `place` and `return`. `ik`: at rest, in postures by inverse kinematics. A file (.npz) written by
    `evaluate terminal_states=`: each episode starts at the joint angles and velocities of one of its states; in
    training also with the person and level of that state; with a gripper, with what it holds. With a gripper, tasks
    that begin with a pick take `pregrasp`, the open hand 0.11 m in front of the object, beside `ik`, at home."""
    arrival_speed_rad_s: Annotated[float, within(0.01, 100.0)] | None
    """A stage can become done only while the speed of all joints together (Euclidean norm) is below this, rad/s; null:
    at any speed."""
    terminate_on: Annotated[str, choice("contact", "unsafe_contact")]
    """Contact with the person that ends an episode: any, or an unsafe one, in which the arm moves towards the person
    faster than 0.25 m/s."""
    resample_start_probability: Annotated[float, within(0.0, 1.0)]
    """Training from recorded starts: probability that person and level are drawn anew for an episode, instead of taken
    from the start; in a cell that varies, also layout and posture."""

    def __post_init__(self) -> None:
        if self.objects > 1 and self.name not in SORTING:
            raise ConfigError(
                f"task.objects={self.objects}, but task.name={self.name} has one; choose {' or '.join(SORTING)}"
            )
        low, high = self.due_s
        if low > high:
            raise ConfigError(f"task.due_s=[{low:g}, {high:g}] is not [low, high]")


Weight = Annotated[float, within(-1e4, 1e4)]


@dataclass(frozen=True)
class RewardConfig:
    """Weight of each reward term; docs/tasks.md has their equations and units."""

    progress: Weight
    """Per m of decrease of the tool's distance from its goal."""
    home_progress: Weight
    """Per rad of decrease of the sum of joint errors, in `return`."""
    pick: Weight
    """Completion of `pick`."""
    place: Weight
    """Completion of `place`."""
    home: Weight
    """Completion of `return`."""
    reach: Weight
    """Completion of `reach`."""
    arrival_speed: Weight
    """Per rad/s of joint speed (Euclidean norm) in the control step that completes a stage of the subtask."""
    contact: Weight
    """Beginning of a contact with the human."""
    other_collision: Weight
    """Contact of the robot with the cell or itself."""
    step: Weight
    """Every control step."""
    overtime: Weight
    """Every control step of an episode after the first 150 (3 s)."""
    return_shaping: Weight
    """In `return`: shaping of the paper's released code, -ln(d + 1)/10 a control step, d the tool's distance from its
    home position, m."""
    align: Weight
    """With a gripper, in `pick`: per rad by which the line from pad to pad turns towards the horizontal."""
    grasp: Weight
    """With a gripper, in `pick`: beginning of a touch of both pads; its end costs as much."""
    lift: Weight
    """With a gripper, in `pick`: per m that the object rises in the hand, up to 0.1 m."""
    drop: Weight
    """With a gripper: a carried object leaves the hand away from its place."""
    object_lost: Weight
    """With a gripper: an object falls to the floor."""
    missed: Weight
    """In `kitting`: an order becomes due before its object is placed."""
    k1: Weight
    """Factor of the weight `pick` (Eq. 1 of the paper)."""
    k2: Weight
    """Factor of the weight `place` (Eq. 1 of the paper)."""
    k3: Weight
    """Factor of the weight `home` (Eq. 1 of the paper)."""


def slot_users(task: TaskConfig, cell: CellConfig, place: str) -> list[int]:
    """Return the indices of the objects that may arrive or belong at a place; those of `kitting` have given kinds."""
    users = [place in (each.arrives_at, each.belongs_at) for each in cell.objects.values()]
    if task.name == "kitting":
        return [index for index, used in enumerate(users) if used]
    return list(range(task.objects)) if any(users) else []


def check_objects(task: TaskConfig, cell: CellConfig, hand: bool) -> None:
    """Raise ConfigError where a task does not go with the objects of a cell; with a `hand` places need slots, too."""
    one_of("task.object", task.object, (RANDOM, *cell.kinds))
    if task.name == "kitting" and task.objects != len(cell.kinds):
        raise ConfigError(
            f"task.objects={task.objects}: task.name=kitting has one of each kind; with these cell.objects choose "
            f"task.objects={len(cell.kinds)}"
        )
    if task.observation == "paper" and len(cell.kinds) < 2:
        raise ConfigError(f"task.observation=paper shows the places of two kinds; cell.objects has {cell.kinds[0]}")
    arrive = sorted({each.arrives_at for each in cell.objects.values()})
    for name in cell.places if hand else arrive:
        needed = len(slot_users(task, cell, name)) if hand else task.objects
        if needed > (slots := len(cell.places[name].slots_m)):
            fewer = "" if task.name == "kitting" else f", or choose task.objects={slots}"
            raise ConfigError(
                f"task.objects={task.objects}, but cell.places.{name}.slots_m has {slots}; add slots{fewer}"
            )
