"""Every choice a user can make, as frozen dataclasses with units and range checks.

Values live in `conf/*.yaml` alone: no field here has a default, so a choice has one home.
Each part of the program is given its own section, never the root.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

CONTROL_STEP_S = 0.02
"""Length of a control step: joints move by at most 2 degrees in it (the paper's unit)."""
FAR_AWAY_M = 50.0
"""Where everything stands, along x, that is not in the cell."""

FIRST_SEED = 1_000_000
"""Episode seeds from here on are those of the evaluation set; training has those below `ENDINGS_SEED`."""
EVALUATION_EPISODES = 1000
"""Entries of the evaluation set."""
ENDINGS_SEED = 900_000
"""Episode seeds from here on, below `FIRST_SEED`, are those of recorded endings."""

CLIPPINGS = ("off", "full", "partial")
SPAWNS = ("points", "anywhere", "mixed")
COLOURS = ("random", "orange", "pink")
ACTIONS = ("joint", "cartesian")
CURRICULA = ("off", "linear", "adaptive")
POINTS = ("fixed", "random")
OBSERVATIONS = ("default", "paper")


class ConfigError(ValueError):
    """A choice that is not allowed; the message names the key, its value and what is allowed."""


def _one_of(key: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise ConfigError(f"{key}={value!r} is not allowed; choose one of {', '.join(allowed)}")


def _between(key: str, value: float, low: float, high: float) -> None:
    if not (math.isfinite(value) and low <= value <= high):
        raise ConfigError(f"{key}={value!r} is outside its range [{low:g}, {high:g}]")


def _point(key: str, value: list[float], size: int) -> None:
    if len(value) != size or not all(math.isfinite(v) for v in value):
        raise ConfigError(f"{key}={list(value)!r} must be {size} finite numbers")


@dataclass(frozen=True)
class RobotConfig:
    """Which arm stands in the cell. Its kinematics and masses are constants of `scene.robots`."""

    name: str
    """A key of `scene.robots.ROBOTS`, which checks it."""
    home_deg: list[float]
    """Joint angles at the start and after `return`, one per joint, degrees."""

    def __post_init__(self) -> None:
        _point("robot.home_deg", self.home_deg, 6)


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
            _point(f"cell.{key}", getattr(self, key), 3)
        _between("cell.ball_radius_m", self.ball_radius_m, 0.005, 0.2)
        _between("cell.table_half_width_m", self.table_half_width_m, 0.02, 1.0)
        _between("cell.base_height_m", self.base_height_m, 0.0, 2.0)


@dataclass(frozen=True)
class HumanConfig:
    """Who walks beside the robot, how, and what the policy is told of it."""

    motion: str
    """A key of `people.motions.MOTIONS`, which checks it."""
    spawns_m: list[list[float]]
    """Spawn points (x, y), metres. Points nearer to a goal than `keep_out_m` are moved out to it."""
    held_out: list[int]
    """Indices into `spawns_m` that training never uses; the evaluation set uses them as unseen."""
    spawn: str
    """In training: `points` draws a spawn point that is not held out, `anywhere` a place round the robot,
    `mixed` either, half the time each."""
    spawn_jitter_m: float
    """At points, a spawn is drawn uniformly from a disc of this radius round its point."""
    spawn_radius_m: list[float]
    """Anywhere: nearest and farthest distance from the robot's base."""
    spawn_margin_m: float
    """In training, least distance from every held-out point, so that these stay unseen."""
    keep_out_m: float
    """Least distance between the human's axis and any goal or the robot's base."""
    bound_m: float
    """Farthest the human strays from its spawn point."""
    jitter_m: float
    """`random_walk`, `arc`: largest random horizontal displacement a control step, each axis."""
    forward_m: float
    """`random_walk`: displacement of an occasional step forward, towards the robot."""
    forward_probability: float
    arc_deg: float
    arc_steps: int
    speed_m_s: float
    """`approach`: walking speed."""
    file: str | None
    """`playback`: CSV of t, x, y, yaw in s, m, m, rad, cell frame."""
    clipping: str
    masked: bool
    """True hides the human from the policy: it sees one standing far away."""

    def __post_init__(self) -> None:
        _one_of("human.clipping", self.clipping, CLIPPINGS)
        if not self.spawns_m:
            raise ConfigError("human.spawns_m=[] must hold at least one point")
        for i, point in enumerate(self.spawns_m):
            _point(f"human.spawns_m[{i}]", point, 2)
        for i in self.held_out:
            _between("human.held_out", i, 0, len(self.spawns_m) - 1)
        if len(set(self.held_out)) >= len(self.spawns_m):
            raise ConfigError(f"human.held_out={list(self.held_out)!r} leaves no spawn for training")
        _one_of("human.spawn", self.spawn, SPAWNS)
        _point("human.spawn_radius_m", self.spawn_radius_m, 2)
        _between("human.spawn_radius_m[0]", self.spawn_radius_m[0], 0.0, self.spawn_radius_m[1])
        _between("human.spawn_margin_m", self.spawn_margin_m, 0.0, 0.5)
        _between("human.spawn_jitter_m", self.spawn_jitter_m, 0.0, 0.5)
        _between("human.keep_out_m", self.keep_out_m, 0.0, 1.0)
        _between("human.bound_m", self.bound_m, 0.0, 10.0)
        _between("human.jitter_m", self.jitter_m, 0.0, 0.1)
        _between("human.forward_m", self.forward_m, 0.0, 0.1)
        _between("human.forward_probability", self.forward_probability, 0.0, 1.0)
        _between("human.arc_deg", self.arc_deg, 0.0, 360.0)
        _between("human.arc_steps", self.arc_steps, 1, 100_000)
        _between("human.speed_m_s", self.speed_m_s, 0.0, 3.0)
        if self.motion == "playback" and self.file is None:
            raise ConfigError("human.file=null: motion=playback needs a CSV of t,x,y,yaw")


@dataclass(frozen=True)
class PrecisionConfig:
    """How near counts as done."""

    take_m: float
    leave_m: float
    home_deg: float

    def __post_init__(self) -> None:
        _between("task.precision.take_m", self.take_m, 0.005, 0.5)
        _between("task.precision.leave_m", self.leave_m, 0.005, 0.5)
        _between("task.precision.home_deg", self.home_deg, 0.1, 60.0)


@dataclass(frozen=True)
class TaskConfig:
    """One subtask (or a chain of them in one network) and its contract with the policy."""

    name: str
    colour: str
    precision: PrecisionConfig
    limit_steps: int
    """Control steps of 20 ms after which an episode is truncated."""
    steps_per_decision: int
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

    def __post_init__(self) -> None:
        _one_of("task.colour", self.colour, COLOURS)
        _one_of("task.action", self.action, ACTIONS)
        _one_of("task.observation", self.observation, OBSERVATIONS)
        _one_of("task.point", self.point, POINTS)
        _between("task.limit_steps", self.limit_steps, 1, 100_000)
        _between("task.steps_per_decision", self.steps_per_decision, 1, 100)
        _between("task.max_step_deg", self.max_step_deg, 0.01, 3.6)
        _between("task.max_step_m", self.max_step_m, 0.001, 0.05)
        _between("task.max_step_rot_deg", self.max_step_rot_deg, 0.01, 10.0)
        _point("task.point_m", self.point_m, 3)
        _point("task.second_point_m", self.second_point_m, 3)


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
    return_shaping: float

    def __post_init__(self) -> None:
        for key, value in vars(self).items():
            _between(f"reward.{key}", value, -1e4, 1e4)


@dataclass(frozen=True)
class ComfortConfig:
    """How comfortable the person is. `level` null: comfort is measured, not rewarded."""

    levels: int
    level: int | None

    def __post_init__(self) -> None:
        _between("comfort.levels", self.levels, 1, 1000)
        if self.level is not None:
            _between("comfort.level", self.level, 1, self.levels)


@dataclass(frozen=True)
class CurriculumConfig:
    """Precision schedule. `task.precision.take_m` follows it, leave and home keep their ratio to it."""

    kind: str
    start_m: float
    end_m: float
    step_m: float
    """`adaptive`: how much one tightening takes off."""
    threshold: float
    """`adaptive`: success share over the last `window` episodes that tightens."""
    window: int
    fraction: float
    """`linear`: share of the training after which `end_m` is reached."""

    def __post_init__(self) -> None:
        _one_of("curriculum.kind", self.kind, CURRICULA)
        _between("curriculum.end_m", self.end_m, 0.005, 0.5)
        _between("curriculum.start_m", self.start_m, self.end_m, 0.5)
        _between("curriculum.step_m", self.step_m, 0.001, 0.5)
        _between("curriculum.threshold", self.threshold, 0.0, 1.0)
        _between("curriculum.window", self.window, 1, 100_000)
        _between("curriculum.fraction", self.fraction, 0.01, 1.0)


@dataclass(frozen=True)
class AgentConfig:
    """Soft actor-critic (Haarnoja et al. 2018), the paper's network and rates by default."""

    decisions: int
    """Policy calls to train for, over all rows."""
    warmup_decisions: int
    """Uniformly random decisions before the first update."""
    updates_per_decision: float
    batch_size: int
    buffer_size: int
    learning_rate: float
    tau: float
    gamma: float
    """Discount per control step; a decision of k steps discounts by gamma**k."""
    hidden: list[int]
    entropy_coefficient: float
    """Initial value; it is learned from there."""
    target_entropy: float
    normalise: bool
    log_every: int
    """Decisions between two rows of metrics.csv."""
    checkpoint_every: int
    """Decisions between two checkpoints."""
    keep_checkpoints: int

    def __post_init__(self) -> None:
        _between("agent.decisions", self.decisions, 1, 1e9)
        _between("agent.warmup_decisions", self.warmup_decisions, 0, 1e8)
        _between("agent.updates_per_decision", self.updates_per_decision, 0.0, 16.0)
        _between("agent.batch_size", self.batch_size, 1, 65536)
        _between("agent.buffer_size", self.buffer_size, self.batch_size, 1e8)
        _between("agent.learning_rate", self.learning_rate, 0.0, 1.0)
        _between("agent.tau", self.tau, 0.0, 1.0)
        _between("agent.gamma", self.gamma, 0.0, 1.0)
        if not self.hidden or any(not 1 <= h <= 8192 for h in self.hidden):
            raise ConfigError(f"agent.hidden={list(self.hidden)!r} must be layer widths from 1 to 8192")
        _between("agent.entropy_coefficient", self.entropy_coefficient, 1e-8, 100.0)
        _between("agent.target_entropy", self.target_entropy, -1000.0, 1000.0)
        _between("agent.log_every", self.log_every, 1, 1e9)
        _between("agent.checkpoint_every", self.checkpoint_every, 1, 1e9)
        _between("agent.keep_checkpoints", self.keep_checkpoints, 1, 1000)


@dataclass(frozen=True)
class EngineConfig:
    """The batched simulation."""

    rows: int
    threads: int
    substeps: int
    """Physics steps a control step of 20 ms."""

    def __post_init__(self) -> None:
        _between("engine.rows", self.rows, 1, 65536)
        _between("engine.threads", self.threads, 1, 256)
        _between("engine.substeps", self.substeps, 1, 100)


@dataclass(frozen=True)
class MetaConfig:
    """What sequences the frozen subtask policies."""

    name: str
    options: list[str]
    """Subtasks in the order in which the scripted controller runs them."""
    time_limit_steps: int
    """Control steps after which an option is preempted."""
    retries: int
    """Further tries of an option that was preempted."""

    def __post_init__(self) -> None:
        _one_of("meta.name", self.name, ("none", "scripted"))
        _between("meta.time_limit_steps", self.time_limit_steps, 1, 100_000)
        _between("meta.retries", self.retries, 0, 100)


@dataclass(frozen=True)
class EnvConfig:
    """What an environment is made of."""

    robot: RobotConfig
    cell: CellConfig
    human: HumanConfig
    comfort: ComfortConfig
    task: TaskConfig
    reward: RewardConfig
    engine: EngineConfig


@dataclass(frozen=True)
class TrainConfig:
    """`hrl-comfort train`."""

    robot: RobotConfig
    cell: CellConfig
    human: HumanConfig
    comfort: ComfortConfig
    task: TaskConfig
    reward: RewardConfig
    engine: EngineConfig
    curriculum: CurriculumConfig
    agent: AgentConfig
    train_seed: int
    episode_seed: int
    output: str
    resume: str | None
    """Run folder to continue; its own config.yaml is used."""
    initial_policy: str | None
    """policy.pt or run folder whose actor, critics and normaliser training starts from."""

    def __post_init__(self) -> None:
        if not self.output:
            raise ConfigError("output='' must be a folder")
        _between("agent.buffer_size", self.agent.buffer_size, self.engine.rows, 1e8)
        _between("train_seed", self.train_seed, 0, 2**63 - 1)
        _between("episode_seed", self.episode_seed, 0, ENDINGS_SEED - 1)


@dataclass(frozen=True)
class EvaluateConfig:
    """`hrl-comfort evaluate`."""

    robot: RobotConfig
    cell: CellConfig
    human: HumanConfig
    comfort: ComfortConfig
    task: TaskConfig
    reward: RewardConfig
    engine: EngineConfig
    meta: MetaConfig
    policy: str | None
    """Run folder, checkpoint or policy file, `expert` or `random`; not used with a meta-controller."""
    policies: dict[str, str]
    """Subtask name to policy, for a meta-controller."""
    checkpoints: str
    """`none`, or `all`: every checkpoint of the run in `policy`."""
    episodes: int
    episode_seed: int
    group_by: list[str]
    """Columns of episodes.csv that split summary.json further."""
    record: bool
    """Write paths.csv."""
    endings: str | None
    """Instead, write how the joints were when episodes drawn as in training succeeded to this .npz: angles,
    velocities and servo targets, the starts of the next subtask."""
    output: str

    def __post_init__(self) -> None:
        _one_of("checkpoints", self.checkpoints, ("none", "all"))
        if not self.output:
            raise ConfigError("output='' must be a folder")
        chained = self.meta.name != "none"
        if chained and self.policy is not None:
            raise ConfigError(
                f"policy={self.policy!r} does not go with meta={self.meta.name}; give policies.*"
            )
        if self.policies and not chained:
            raise ConfigError("policies.* go with a meta-controller: meta=scripted")
        if self.checkpoints == "all" and (chained or self.record or self.endings is not None):
            raise ConfigError("checkpoints=all goes with meta=none, record=false and without endings=")
        _between("episodes", self.episodes, 1, EVALUATION_EPISODES if self.endings is None else 10**6)
        _between("episode_seed", self.episode_seed, FIRST_SEED, 2**31)


@dataclass(frozen=True)
class ReportConfig:
    """`hrl-comfort report`."""

    run: str
    """Folder that holds run folders and their `eval/`, or one run folder."""
    output: str | None
    video: bool
