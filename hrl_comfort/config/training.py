"""Configuration of the commands that train."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import BeforeValidator

from hrl_comfort.config.checks import ConfigError, between, choice, within
from hrl_comfort.config.commands import DISTURBANCES, EnvConfig, check_disturbance
from hrl_comfort.config.constants import VALIDATION_SEED
from hrl_comfort.config.hierarchy import MetaControllerAgentConfig, MetaControllerConfig
from hrl_comfort.config.learning import AgentConfig, CurriculumConfig, StageConfig
from hrl_comfort.config.task import SORTING

LEVEL_OF_EPISODE = ("random", "fixed")
"""Sources of a comfort level that holds for a whole episode, whatever the arm does."""


@dataclass(frozen=True)
class TrainingConfig(EnvConfig):
    """Keys of every training."""

    train_seed: Annotated[int, within(0, 2**63 - 1)]
    """Seed of networks, exploration and replay."""
    episode_seed: Annotated[int, within(0, VALIDATION_SEED - 1)]
    """Seed of the episodes."""
    output: str
    """Run folder."""
    resume: str | None
    """Run folder of a stopped training, which continues with its own config.yaml."""


@dataclass(frozen=True)
class TrainConfig(TrainingConfig):
    """`hrl-comfort train`."""

    curriculum: CurriculumConfig
    agent: AgentConfig
    initial_policy: str | None
    """policy.pt or run folder from which actor, critics and normaliser start; null starts them at random."""
    logger: Annotated[str, choice("tensorboard", "wandb")]
    """Destination of the curves of metrics.csv: TensorBoard's file alone, or Weights & Biases too."""

    def __post_init__(self) -> None:
        super().__post_init__()
        between("agent.buffer_size", self.agent.buffer_size, self.engine.num_envs, 1e8)
        if self.agent.demonstrator_envs >= self.engine.num_envs:
            raise ConfigError(
                f"agent.demonstrator_envs={self.agent.demonstrator_envs} must be below "
                f"engine.num_envs={self.engine.num_envs}"
            )
        if self.agent.other_level:
            self._check_other_level()

    def _check_other_level(self) -> None:
        given, source = f"agent.other_level={self.agent.other_level:g}", self.comfort.source
        if source not in LEVEL_OF_EPISODE:
            raise ConfigError(
                f"{given} goes with levels that hold for an episode; with comfort.source={source} choose "
                f"comfort.source={' or '.join(LEVEL_OF_EPISODE)}, or agent.other_level=0"
            )
        if self.agent.next_skill is not None:
            raise ConfigError(
                f"{given} and agent.next_skill={self.agent.next_skill}: what the next skill expects is known at the "
                "level of the episode alone; leave one of them out"
            )
        if self.agent.name == "hiro":
            raise ConfigError(
                f"{given} does not go with agent=hiro, whose upper policy learns from several decisions at one level; "
                "choose agent.other_level=0"
            )


@dataclass(frozen=True)
class MetaControllerTrainConfig(TrainingConfig):
    """`hrl-comfort train meta_controller`: training of a meta-controller over frozen policies."""

    meta_controller: MetaControllerConfig
    meta_controller_agent: MetaControllerAgentConfig
    policies: dict[str, str]
    """Policy of each subtask."""
    disturbance: Annotated[str, choice(*DISTURBANCES)]
    """Once in every episode: `drop` knocks an object out of the gripper, `block` puts a person where it
    belongs for 8 s."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.task.name not in SORTING:
            raise ConfigError(
                f"task.name={self.task.name!r} has one order of options; train meta_controller takes "
                "task=sort, shift or kitting"
            )
        check_disturbance(self.disturbance, self)
        self.meta_controller.check_policies(self.task.name, self.policies)
        if self.meta_controller.further_options and self.meta_controller_agent.network == "shared":
            raise ConfigError(
                f"meta_controller.further_options={self.meta_controller.further_options} does not go with "
                "meta_controller_agent.network=shared, which knows the options of the task alone; choose flat"
            )
        if self.meta_controller.name != "learned":
            name = self.meta_controller.name
            raise ConfigError(f"meta_controller.name={name!r} is not trained; choose meta_controller=learned")
        if self.meta_controller_agent.rule_envs >= self.engine.num_envs:
            raise ConfigError(
                f"meta_controller_agent.rule_envs={self.meta_controller_agent.rule_envs} must be below "
                f"engine.num_envs={self.engine.num_envs}, so that the learner chooses somewhere"
            )


@dataclass(frozen=True)
class HierarchyConfig:
    """Budgets and steps of a hierarchy's trainings."""

    budget_fractions: dict[str, Annotated[float, within(0.001, 1000.0)]]
    """Budget of each option's training, as a multiple of `agent.policy_steps`. The curriculum stages of that training
    are lengthened or shortened in proportion."""
    starts: Annotated[str, choice("recorded", "ik")]
    """Begin of an option's episodes in training: `recorded`, in terminal states of the option before it; `ik`, as
    `task.start=ik` says, so that options can be trained at the same time."""
    terminal_states_episodes: Annotated[int, within(2, 10**6)]
    """`recorded`: number of episodes run to record terminal states; the next option is trained from the ends of those
    that succeed."""
    refinement: list[StageConfig]
    """Curriculum stages of a second training of every option, from the last of the cycle to the first; []: no second
    training. When an option succeeds in this training, it also earns a value for the state it reached, from the critics
    of the next option in the cycle (`agent.next_skill`). The last option of the cycle earns nothing extra."""
    episodes: Annotated[int, within(1, 1000)]
    """Episodes of every evaluation."""
    jobs: Annotated[int, within(1, 256)]
    """Evaluations, and with `starts=ik` trainings of options, that run at a time, each in a process of its own."""
    levels: list[int]
    """Comfort levels of every evaluation, as in `evaluate`."""
    controller: Annotated[MetaControllerTrainConfig | None, BeforeValidator(lambda given: given or None)]
    """Overrides for a `train meta_controller` that runs after the options are trained, for example `['human=patrol']`;
    its task is `sort` unless they name another. []: no such training."""


@dataclass(frozen=True)
class HierarchyTrainConfig(TrainConfig):
    """`hrl-comfort train hierarchy`; the sections of `train` hold for every option."""

    meta_controller: MetaControllerConfig
    hierarchy: HierarchyConfig

    def __post_init__(self) -> None:
        super().__post_init__()
        self.meta_controller.check("cycle")
        for key, value, default in (
            ("task.name", self.task.name, "pick"),
            ("task.start", self.task.start, "ik"),
            ("initial_policy", self.initial_policy, None),
            ("agent.next_skill", self.agent.next_skill, None),
        ):
            if value != default:
                raise ConfigError(f"{key}={value}: train hierarchy sets it for each option; leave it out")
        if self.agent.other_level and self.hierarchy.refinement:
            raise ConfigError(
                f"agent.other_level={self.agent.other_level:g} does not go with hierarchy.refinement, in which options "
                "earn what the next one expects; leave one of them out"
            )
        for option in self.meta_controller.options:
            if option not in self.hierarchy.budget_fractions:
                raise ConfigError(f"hierarchy.budget_fractions has no {option}, an option of the division")
        if self.hierarchy.controller and list(self.meta_controller.options) != ["pick", "place", "return"]:
            raise ConfigError(
                "hierarchy.controller chooses among pick, place and return: choose division=three, or "
                "hierarchy.controller=[]"
            )
