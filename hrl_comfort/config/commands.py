"""What each command takes: sections and a few keys of its own."""

from __future__ import annotations

from dataclasses import dataclass

from hrl_comfort.config.cell import CellConfig, EngineConfig, RobotConfig
from hrl_comfort.config.checks import ConfigError, between, one_of
from hrl_comfort.config.comfort import ComfortConfig
from hrl_comfort.config.constants import EVALUATION_EPISODES, FIRST_SEED, TERMINAL_STATES_SEED, VALIDATION_SEED
from hrl_comfort.config.human import HumanConfig
from hrl_comfort.config.learning import AgentConfig, CurriculumConfig
from hrl_comfort.config.meta_controller import MetaControllerAgentConfig, MetaControllerConfig
from hrl_comfort.config.task import RewardConfig, TaskConfig


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


def _check_seeds(train_seed: int, episode_seed: int) -> None:
    between("train_seed", train_seed, 0, 2**63 - 1)
    between("episode_seed", episode_seed, 0, VALIDATION_SEED - 1)


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
        between("agent.buffer_size", self.agent.buffer_size, self.engine.num_envs, 1e8)
        between("agent.demonstrator_envs", self.agent.demonstrator_envs, 0, self.engine.num_envs - 1)
        _check_seeds(self.train_seed, self.episode_seed)


DISTURBANCES = ("none", "drop", "block")
"""What `sim.disturbance` knows of."""


@dataclass(frozen=True)
class MetaControllerTrainConfig:
    """`hrl-comfort train meta_controller`: a controller above frozen policies."""

    robot: RobotConfig
    cell: CellConfig
    human: HumanConfig
    comfort: ComfortConfig
    task: TaskConfig
    reward: RewardConfig
    engine: EngineConfig
    meta_controller: MetaControllerConfig
    meta_controller_agent: MetaControllerAgentConfig
    policies: dict[str, str]
    """Subtask name to policy."""
    disturbance: str
    """What goes wrong on purpose, once an episode: `none`, `drop` or `block` (`sim.disturbance`)."""
    train_seed: int
    episode_seed: int
    output: str
    resume: str | None
    """Run folder to continue; its own config.yaml is used."""

    def __post_init__(self) -> None:
        one_of("disturbance", self.disturbance, DISTURBANCES)
        if self.task.name != "sort":
            raise ConfigError(
                f"task.name={self.task.name!r} leaves nothing to choose; train meta_controller takes task=sort"
            )
        if self.meta_controller.name != "learned":
            raise ConfigError(
                f"meta_controller.name={self.meta_controller.name!r} learns nothing; choose meta_controller=learned"
            )
        _check_seeds(self.train_seed, self.episode_seed)


VALIDATION_EPISODES = 10_000
SPLITS = {
    "paper": (FIRST_SEED, 2**31, EVALUATION_EPISODES),
    "validation": (VALIDATION_SEED, TERMINAL_STATES_SEED - VALIDATION_EPISODES, VALIDATION_EPISODES),
}
"""Smallest and largest seed of a first episode, and the largest number of episodes, by split."""
HOLDING = ("pick_place", "cycle", "sort")
"""Tasks in which a ball is picked and then placed."""


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
    meta_controller: MetaControllerConfig
    policy: str | None
    """Run folder, checkpoint, policy file, `expert`, `potential_field` or `random`; not used with a meta-controller."""
    policies: dict[str, str]
    """Subtask name to policy, for a meta-controller."""
    checkpoints: str
    """`none`, or `all`: every checkpoint of the run in `policy`."""
    split: str
    """One of SPLITS: the committed evaluation set (`paper`), or episodes drawn as in training (`validation`)."""
    episodes: int
    episode_seed: int | None
    """Seed of the first episode; null: the split's first."""
    levels: list[int]
    """Comfort levels to evaluate one after the other, the same episodes at each; none: as `comfort` says."""
    group_by: list[str]
    """Columns of episodes.csv that split summary.json further."""
    record: bool
    """Write paths.csv."""
    disturbance: str
    """What goes wrong on purpose, once an episode: `none`, `drop` or `block` (`sim.disturbance`)."""
    terminal_states: str | None
    """Instead, write how the joints were when episodes drawn as in training succeeded to this .npz: angles,
    velocities and servo targets, the starts of the next subtask."""
    output: str

    def __post_init__(self) -> None:
        one_of("checkpoints", self.checkpoints, ("none", "all"))
        one_of("disturbance", self.disturbance, DISTURBANCES)
        if self.disturbance != "none":
            self._check_disturbance()
        chained = self.meta_controller.name != "none"
        if chained and self.policy is not None:
            raise ConfigError(
                f"policy={self.policy!r} does not go with meta_controller={self.meta_controller.name}; give policies.*"
            )
        if self.policies and not chained:
            raise ConfigError("policies.* go with a meta-controller: meta_controller=scripted")
        if self.checkpoints == "all" and (chained or self.record or self.terminal_states is not None):
            raise ConfigError(
                "checkpoints=all goes with meta_controller=none, record=false and without terminal_states="
            )
        if self.levels:
            self._check_levels()
        one_of("split", self.split, tuple(SPLITS))
        first, last, most = SPLITS[self.split]
        between("episodes", self.episodes, 1, most if self.terminal_states is None else 10**6)
        if self.episode_seed is not None:
            between("episode_seed", self.episode_seed, first, last)

    @property
    def first_seed(self) -> int:
        """Seed of the first episode."""
        return SPLITS[self.split][0] if self.episode_seed is None else self.episode_seed

    def _check_disturbance(self) -> None:
        if self.disturbance == "drop" and self.task.name not in HOLDING:
            raise ConfigError(
                f"disturbance=drop needs a ball that is picked and then placed; task.name={self.task.name!r} "
                f"is not one of {', '.join(HOLDING)}"
            )
        if self.disturbance == "block" and self.human.motion in ("none", "playback"):
            raise ConfigError(f"disturbance=block needs a person who can stand; not human={self.human.motion}")
        if self.terminal_states is not None:
            raise ConfigError(f"disturbance={self.disturbance} does not go with terminal_states=")

    def _check_levels(self) -> None:
        levels, source = list(self.levels), self.comfort.source
        for level in levels:
            between("levels", level, 1, self.comfort.levels)
        if len(set(levels)) < len(levels):
            raise ConfigError(f"levels={levels} names a level twice")
        if source not in ("none", "fixed", "random"):
            raise ConfigError(f"levels={levels} does not go with comfort.source={source}; choose none, fixed or random")
        if self.terminal_states is not None:
            raise ConfigError(f"levels={levels} does not go with terminal_states=; choose a comfort.source")
        if self.checkpoints == "all":
            raise ConfigError(f"levels={levels} does not go with checkpoints=all; choose a comfort.source")


@dataclass(frozen=True)
class ReportConfig:
    """`hrl-comfort report`."""

    run: str
    """Folder that holds run folders and their `eval/`, or one run folder."""
    output: str | None
    video: bool


FIGURES = (
    "levels", "speed", "plane", "paths", "people", "jump", "timeline", "chain", "controllers", "divisions",
    "handover",
)  # fmt: skip


@dataclass(frozen=True)
class FigureConfig:
    """`hrl-comfort figure`."""

    kind: str
    """One of FIGURES."""
    evaluations: list[str]
    """Folders of evaluations, or patterns of them: `runs/*/eval`."""
    output: str
    """The PNG; where there are numbers they go to a JSON file of the same name beside it."""
    labels: list[str]
    """`plane`, `people`: a name for each of `evaluations`; those of one name are one series of `plane`."""
    over: str
    """`levels`, `speed`, `plane`: over `pairs`, the episodes that succeed at every level, or over `all`."""
    levels: list[int]
    """`paths`: levels to draw; `people`: the one level to draw."""
    episodes: list[int]
    """`paths`, `people`: one or two; none: the first orange and the first pink one that succeed in all.
    `timeline`: any; none: the first twelve."""
    jump_s: float | None
    """`jump`: when the level changes, seconds from the start of the episode."""

    def __post_init__(self) -> None:
        one_of("kind", self.kind, FIGURES)
        one_of("over", self.over, ("pairs", "all"))
        if not self.evaluations:
            raise ConfigError("evaluations=[] must name at least one folder of an evaluation")
        if not self.output.endswith(".png"):
            raise ConfigError(f"output={self.output!r} must end in .png")
        if self.labels and len(self.labels) != len(self.evaluations):
            raise ConfigError(f"labels={list(self.labels)} must be as many as evaluations, or none")
        if len(self.episodes) > 2 and self.kind != "timeline":
            raise ConfigError(f"episodes={list(self.episodes)} must be one or two, a panel each")
        if self.kind == "people" and len(self.levels) > 1:
            raise ConfigError(f"levels={list(self.levels)} must be one level: kind=people compares motions")
        if self.kind == "jump":
            if self.jump_s is None:
                raise ConfigError("jump_s=null: kind=jump needs the time of the jump, such as jump_s=0.6")
            between("jump_s", self.jump_s, 0.0, 3600.0)
            if len(self.evaluations) != 2:
                raise ConfigError("kind=jump needs two evaluations: without the jump, and with it")
