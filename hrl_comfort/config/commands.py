"""Configuration of each command but the trainings: shared sections and keys of its own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Self

from pydantic import ConfigDict, Field

from hrl_comfort.config.cell import CellConfig, ConnectionConfig, EngineConfig, RobotConfig
from hrl_comfort.config.checks import ConfigError, between, choice, unique, within
from hrl_comfort.config.comfort import ComfortConfig
from hrl_comfort.config.constants import PREGRASP, SPLITS
from hrl_comfort.config.hierarchy import LOOKAHEAD, ORACLE, STEADY, MetaControllerConfig, check_ahead
from hrl_comfort.config.human import HumanConfig
from hrl_comfort.config.safety import RandomiseConfig, SafetyConfig
from hrl_comfort.config.task import SORTING, RewardConfig, TaskConfig, check_objects

DISTURBANCES = ("none", "drop", "block")
"""Kinds of `sim.variation.disturbance`: nothing; the object is dropped; a human blocks a place."""
LIVE_MOTIONS = ("live", "recorded", "none")
"""Motions of people beside a real arm."""
GRASP_SUBSTEPS = 4
"""Smallest number of physics steps in a control step with a gripper: at 10 ms a held cube slips."""
PICK_AND_PLACE = ("pick_place", "cycle", *SORTING)
"""Tasks that pick an object and then place it."""
FIGURES = (
    "levels", "speed", "plane", "paths", "people", "jump", "timeline", "chain", "options", "controllers",
    "divisions", "handover",
)  # fmt: skip


@dataclass(frozen=True)
class CommandConfig:
    """A command's configuration; its settings of pydantic hold for every section."""

    __pydantic_config__ = ConfigDict(extra="forbid", str_min_length=1)


@dataclass(frozen=True)
class EnvConfig(CommandConfig):
    """Sections of an environment."""

    robot: RobotConfig
    cell: CellConfig
    human: HumanConfig
    comfort: ComfortConfig
    task: TaskConfig
    reward: RewardConfig
    engine: EngineConfig
    safety: SafetyConfig
    randomise: RandomiseConfig

    def __post_init__(self) -> None:
        task, cell = self.task, self.cell
        if task.start == PREGRASP and not self.robot.gripper.holds:
            raise ConfigError(
                "task.start=pregrasp puts a hand in front of an object; choose gripper=two_finger, or task.start=ik"
            )
        check_objects(task, cell, self.robot.gripper.holds)
        if self.engine.processes > 1:
            self._check_processes()

    def _check_processes(self) -> None:
        live, source = None, self.comfort.source
        if source in ("udp", "lsl"):
            live = f"comfort.source={source}"
        elif any(each.motion == "live" for person in self.human.everyone for each in (person.people or [person])):
            live = "human.motion=live"
        if live is not None:
            raise ConfigError(
                f"engine.processes={self.engine.processes} does not go with {live}, which one process reads; choose "
                "engine.processes=1"
            )

    def in_one_process(self) -> Self:
        """Return the same configuration with `engine.processes=1`."""
        return replace(self, engine=replace(self.engine, processes=1))

    @property
    def substeps(self) -> int:
        """Physics steps in a control step."""
        return max(self.engine.substeps, GRASP_SUBSTEPS) if self.robot.gripper.holds else self.engine.substeps


def check_disturbance(disturbance: str, config: EnvConfig) -> None:
    """Raise ConfigError if one of DISTURBANCES does not go with the task, the hand or the person of `config`."""
    if disturbance == "drop" and config.task.name not in PICK_AND_PLACE:
        raise ConfigError(
            f"disturbance=drop needs an object that is picked and then placed; task.name={config.task.name!r} "
            f"is not one of {', '.join(PICK_AND_PLACE)}"
        )
    if disturbance == "drop" and config.robot.gripper.holds:
        raise ConfigError(
            f"disturbance=drop is for objects that ride on the tool; robot.gripper.name={config.robot.gripper.name} "
            "holds them: choose disturbance=none, or gripper=none"
        )
    if disturbance == "block" and config.human.motion in ("none", "recorded"):
        raise ConfigError(f"disturbance=block needs a human who can stand still; not human={config.human.motion}")


@dataclass(frozen=True)
class EvaluateConfig(EnvConfig):
    """`hrl-comfort evaluate`."""

    meta_controller: MetaControllerConfig
    policy: str | None
    """Without a meta-controller: run folder, checkpoint (a file, `RUN@best` or `RUN@step=40000`), policy file,
    `package.module:callable`, `sb3:FILE.zip`, `onnx:FILE`, `expert`, `potential_field`, `predictive_sampling` or
    `random`."""
    policies: dict[str, str]
    """With a meta-controller: the policy of each subtask (`policies.pick=…` and so on); for a learned controller, also
    its run folder or file (`policies.meta_controller=…`)."""
    checkpoints: Annotated[str, choice("none", "all", "grid")]
    """`all` evaluates every checkpoint of the run in `policy`, or of the runs in `policies`: at each checkpoint of the
    one that has most, the others join with the checkpoint nearest in fraction of their own training. `grid` evaluates
    every combination of the checkpoints of the runs in `policies`."""
    split: Annotated[str, choice(*SPLITS)]
    """`paper`: the committed evaluation set. `train`, `validation`: drawn as in training; if `human.partitioned`,
    `validation` has people of its own. `test`: people, layouts and arm starts that no training with
    `human.partitioned` sees; each look at it is a line of runs/ledger.csv."""
    episodes: int
    """Number of episodes; with `levels`, at each level."""
    episode_seed: int | None
    """Seed of the first episode; null is the first seed of the split."""
    levels: Annotated[list[int], unique]
    """Comfort levels at which the same episodes are run; [] leaves the level to `comfort`."""
    group_by: list[str]
    """Further columns of episodes.csv by which summary.json is grouped."""
    record: bool
    """Write paths.csv, the motion of arm and person at every control step."""
    realtime: bool
    """Run episodes no faster than the wall clock, for live levels and people."""
    disturbance: Annotated[str, choice(*DISTURBANCES)]
    """Once in every episode: `drop` knocks an object out of the gripper, `block` puts a person where it
    belongs for 8 s."""
    terminal_states: str | None
    """File (.npz) for the states at the end of successful episodes: joint angles, velocities and servo targets (rad,
    rad/s), and the person's position (m) and level. Episodes are drawn as in training, and nothing else is written."""
    regret: bool
    """With a meta-controller: judge its choices by the oracle, which takes long; see the column `regret_per_min`."""
    output: str
    """Folder of the evaluation."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_disturbance(self.disturbance, self)
        if self.disturbance != "none" and self.terminal_states is not None:
            raise ConfigError(f"disturbance={self.disturbance} does not go with terminal_states=")
        self.meta_controller.check(self.task.name)
        chained = self.meta_controller.name != "none"
        if chained and self.policy is not None:
            raise ConfigError(
                f"policy={self.policy!r} does not go with meta_controller={self.meta_controller.name}; give policies.*"
            )
        if self.policies and not chained:
            raise ConfigError("policies.* go with a meta-controller: meta_controller=nearest")
        further = ["meta_controller"] * (self.meta_controller.name == "learned")
        if chained:
            self.meta_controller.check_policies(self.task.name, self.policies, further)
        self.check_ahead(self.meta_controller.name)
        if self.regret and not chained:
            raise ConfigError("regret=true judges the choices of a meta-controller; give one, or regret=false")
        several = f"checkpoints={self.checkpoints}"
        if self.checkpoints != "none" and (self.record or self.regret or self.terminal_states is not None):
            raise ConfigError(f"{several} goes with record=false and regret=false, and without terminal_states=")
        if self.checkpoints != "none" and self.split == "test":
            raise ConfigError(f"{several} chooses among checkpoints, which split=test is not for; use validation")
        if self.terminal_states is not None and self.split == "test":
            raise ConfigError("terminal_states= records training data, which split=test is not for; leave split= out")
        if self.levels:
            self._check_levels()
        first, last, most = SPLITS[self.split]
        between("episodes", self.episodes, 1, most if self.terminal_states is None else 10**6)
        between("episode_seed", self.first_seed, first, last)

    def check_ahead(self, top: str) -> None:
        """Raise ConfigError if `top`, or a judge of it, would know too much ahead of this world, or nothing."""
        motions = {name for each in self.human.everyone for name in (each.motion, *each.mixture)}
        for each in (top, *[ORACLE] * self.regret):
            check_ahead(each, motions, self.comfort.source, self.disturbance)

    @property
    def first_seed(self) -> int:
        """Seed of the first episode."""
        return SPLITS[self.split][0] if self.episode_seed is None else self.episode_seed

    def check_left_out(self) -> None:
        """Raise ConfigError if a key is set that evaluations alone read."""
        for key, default in ("checkpoints", "none"), ("levels", []), ("terminal_states", None), ("regret", False):
            if (value := getattr(self, key)) != default:
                raise ConfigError(f"{key}={value} is for hrl-comfort evaluate; leave it out")
        if (name := self.meta_controller.name) in (ORACLE, LOOKAHEAD):
            raise ConfigError(f"meta_controller={name} looks ahead in simulation alone; choose another")

    def _check_levels(self) -> None:
        said, source = f"levels={list(self.levels)}", self.comfort.source
        for level in self.levels:
            between("levels", level, 1, self.comfort.levels)
        if source not in STEADY:
            raise ConfigError(f"{said} does not go with comfort.source={source}; choose {', '.join(STEADY)}")
        if self.terminal_states is not None:
            raise ConfigError(f"{said} does not go with terminal_states=; choose a comfort.source")


@dataclass(frozen=True)
class StudioConfig(EvaluateConfig):
    """`hrl-comfort studio`; `policy` or `policies` act, recordings go to `output`."""

    beside: str | None
    """Second policy, or folder of policies, that acts in a second cell beside the same person."""
    replay: str | None
    """Recorded evaluation to play back: its folder, which holds paths.csv, or a run folder with paths.csv in eval/."""
    export: str | None
    """HTML file that plays the policies without a server, instead of the live view."""
    host: str
    """Address to listen on. Any but the loopback needs a token, which is printed with the address."""
    port: Annotated[int, within(0, 65535)]
    """Port to listen on; if it is taken, the next free one; 0 is any free port."""
    speed: Annotated[float, within(0.1, 4.0)]
    """Simulated time per wall-clock time."""
    frames_per_s: Annotated[float, within(1.0, 60.0)]
    """Pictures a second."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_left_out()


@dataclass(frozen=True)
class DeployConfig(EvaluateConfig):
    """`hrl-comfort deploy`."""

    connection: ConnectionConfig
    confirm: Annotated[str, choice("ask", "yes")]
    """`ask` moves the arm only when `move` is typed after the dry run; `yes`, for simulated arms only, does not ask."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_left_out()
        self.connection.check_moves(self.robot.gripper)
        if self.robot.rating == "paper":
            raise ConfigError("robot.rating=paper has no limits to keep to; choose robot.rating=collaborative or full")
        if self.safety.kind == "none":
            raise ConfigError("safety.kind=none leaves the arm without its shield; choose safety=ssm")
        if self.randomise.differs:
            raise ConfigError("randomise= is for simulated cells, not for an arm; choose randomise=none")
        if (real := self.connection.name != "simulated") and self.confirm == "yes":
            raise ConfigError(f"confirm=yes is for connection=simulated; connection={self.connection.name} asks")
        if real and not all(each.motion in LIVE_MOTIONS for each in self.human.everyone):
            choices = ", ".join(LIVE_MOTIONS)
            raise ConfigError(f"human.motion={self.human.motions} is nobody beside a real arm; choose one of {choices}")


@dataclass(frozen=True)
class ExportConfig(EnvConfig):
    """`hrl-comfort export`."""

    policy: str | None
    """Run folder, checkpoint or policy file; or give `policies`."""
    policies: dict[str, str]
    """Policy of each subtask of a chain, in order."""
    output: str
    """Folder of the files."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.policy is None) == (not self.policies):
            raise ConfigError(f"policy={self.policy} policies={self.policies}: give one of the two")


@dataclass(frozen=True)
class ReportConfig(CommandConfig):
    """`hrl-comfort report`."""

    run: str
    """Run folder, or a folder that holds run folders; their evaluations in `eval/` are read too."""
    output: str | None
    """HTML file; null is report.html in `run`."""
    video: bool
    """Include videos of the first recorded failure and success."""
    episode: int | None = None
    """Recorded episode of the video, in place of the first failure and the first success."""
    speed: Annotated[float, within(0.1, 1.0)] = 1.0
    """Speed of the video; 0.5 is half."""


@dataclass(frozen=True)
class ResultsConfig(CommandConfig):
    """`hrl-comfort results`."""

    name: str | None
    """Result whose commands are shown; null lists all with their states."""
    remake: str | None
    """Result whose evaluations and figures are made anew; `stale` and `all` stand for several."""
    train: bool
    """With `remake`, train the policies anew too."""
    verify: str | None
    """Result whose first episodes are run again and compared digit by digit; `stale` and `all` stand for several."""
    fill: bool
    """Fill the marked tables and numbers of README.md and docs/ from the committed results."""
    jobs: Annotated[int, within(1, 256)] = 1
    """Commands that `remake` runs at a time."""


@dataclass(frozen=True)
class IdentifyConfig(CommandConfig):
    """`hrl-comfort identify`."""

    run: str
    """Folder that `hrl-comfort deploy` wrote."""
    output: str | None
    """JSON file for the fitted lags and latencies; null is identify.json in `run`."""


@dataclass(frozen=True)
class FigureConfig(CommandConfig):
    """`hrl-comfort figure`."""

    kind: Annotated[str, choice(*FIGURES)]
    """Kind of figure."""
    evaluations: Annotated[list[str], Field(min_length=1)]
    """Folders of evaluations, or patterns such as `runs/*/eval`."""
    output: Annotated[str, Field(pattern=r"\.png$")]
    """PNG file; its numbers, if any, go to a JSON file of the same name."""
    labels: list[str]
    """A name for each of `evaluations`, for kinds that compare them. Equal names are pooled, except in `people`."""
    over: Annotated[str, choice("pairs", "all")]
    """`levels`, `speed`, `plane`: `pairs` averages over episodes that succeed at every level, `all` over all."""
    levels: list[int]
    """`paths`: levels to show. `people`: the level to show."""
    episodes: list[int]
    """`paths`, `people`: one or two episodes; []: for each kind of object, the first that succeeds at all levels shown
    (`paths`) or beside all motions shown (`people`). `timeline`: any number; []: the first twelve."""
    jump_s: float | None
    """`jump`: time of the level change, s from the start of the episode."""

    def __post_init__(self) -> None:
        if self.labels and len(self.labels) != len(self.evaluations):
            raise ConfigError(f"labels={list(self.labels)} must be as many as evaluations, or none")
        if len(self.episodes) > 2 and self.kind != "timeline":
            raise ConfigError(f"episodes={list(self.episodes)} must be one or two, one a panel")
        if self.kind == "people" and len(self.levels) > 1:
            raise ConfigError(f"levels={list(self.levels)} must be one level: kind=people compares motions")
        if self.kind == "jump":
            if self.jump_s is None:
                raise ConfigError("jump_s=null: kind=jump needs the time of the jump, such as jump_s=0.6")
            between("jump_s", self.jump_s, 0.0, 3600.0)
            if len(self.evaluations) != 2:
                raise ConfigError("kind=jump needs two evaluations: without the jump, and with it")
