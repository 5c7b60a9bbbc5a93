"""Configuration of `hrl-comfort train hierarchy`: a training for each option of a cycle, then the whole."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from hrl_comfort.config.checks import ConfigError, between, check_fields, within
from hrl_comfort.config.commands import TrainConfig
from hrl_comfort.config.learning import StageConfig
from hrl_comfort.config.meta_controller import MetaControllerConfig


@dataclass(frozen=True)
class HierarchyConfig:
    """Budgets and steps of a hierarchy's trainings."""

    shares: dict[str, float]
    """Budget of each option's training, as a multiple of `agent.policy_steps`; so of every stage."""
    terminal_states_episodes: Annotated[int, within(2, 10**6)]
    """Episodes that record the starts of the next option."""
    refinement: list[StageConfig]
    """Stages of a second training of every option, from the last to the first, with the value of the next skill;
    none: no second training."""
    episodes: Annotated[int, within(1, 1000)]
    """Episodes of every evaluation."""
    levels: list[int]
    """Comfort levels of every evaluation, as in `evaluate`."""
    controller: list[str]
    """Overrides of `train meta_controller`, run above the options; none: the scripted controller alone."""

    def __post_init__(self) -> None:
        check_fields("hierarchy", self)
        for name, share in self.shares.items():
            between(f"hierarchy.shares.{name}", share, 0.001, 1000.0)


@dataclass(frozen=True)
class HierarchyTrainConfig(TrainConfig):
    """`hrl-comfort train hierarchy`; the sections of `train` hold for every option."""

    meta_controller: MetaControllerConfig
    hierarchy: HierarchyConfig

    def __post_init__(self) -> None:
        super().__post_init__()
        for key, value, default in (
            ("task.name", self.task.name, "pick"),
            ("task.start", self.task.start, "ik"),
            ("initial_policy", self.initial_policy, None),
            ("agent.next_skill", self.agent.next_skill, None),
        ):
            if value != default:
                raise ConfigError(f"{key}={value}: train hierarchy sets it for each option; leave it out")
        for option in self.meta_controller.options:
            if option not in self.hierarchy.shares:
                raise ConfigError(f"hierarchy.shares has no {option}, an option of the division")
        if self.hierarchy.controller and list(self.meta_controller.options) != ["pick", "place", "return"]:
            raise ConfigError("hierarchy.controller= sorts with pick, place and return: choose division=three")
