"""What sequences the subtasks, and how it is taught."""

from __future__ import annotations

from dataclasses import dataclass

from hrl_comfort.config.checks import ConfigError, between, one_of, widths

CONTROLLERS = ("none", "scripted", "cautious", "random", "learned")


@dataclass(frozen=True)
class MetaControllerConfig:
    """What sequences the frozen subtask policies."""

    name: str
    options: list[str]
    """Subtasks in the order in which the scripted controller runs them."""
    time_limit_steps: int
    """Control steps after which an option, of `sort` a skill, is preempted."""
    retries: int
    """Further tries of an option that was preempted; `sort` tries until the episode's time is up."""
    level_override: list[int]
    """`sort`: levels, 1 to `comfort.levels`, that a skill may be told instead of the one in force."""

    def __post_init__(self) -> None:
        one_of("meta_controller.name", self.name, CONTROLLERS)
        between("meta_controller.time_limit_steps", self.time_limit_steps, 1, 100_000)
        between("meta_controller.retries", self.retries, 0, 100)
        for level in self.level_override:
            between("meta_controller.level_override", level, 1, 1000)
        if len(set(self.level_override)) < len(self.level_override):
            raise ConfigError(f"meta_controller.level_override={list(self.level_override)} names a level twice")


@dataclass(frozen=True)
class MetaControllerAgentConfig:
    """Double DQN over options (van Hasselt, Guez, Silver 2016)."""

    options: int
    """Options, over all rows, to learn from."""
    warmup_options: int
    """Options chosen at random before the first update."""
    updates_per_option: float
    batch_size: int
    buffer_size: int
    learning_rate: float
    tau: float
    ema_rate: float
    """Share of the newest network, at each update, in the mean of networks that is kept; 1: the newest."""
    gamma: float
    """Discount per control step; an option of k steps discounts by gamma**k."""
    hidden: list[int]
    exploration_start: float
    exploration_end: float
    """Probability of an option at random: from start to end over the first half of the training."""
    log_every: int
    """Options between two rows of meta_controller_metrics.csv, and two checkpoints."""

    def __post_init__(self) -> None:
        between("meta_controller_agent.options", self.options, 1, 1e9)
        between("meta_controller_agent.warmup_options", self.warmup_options, 0, 1e9)
        between("meta_controller_agent.updates_per_option", self.updates_per_option, 0.0, 16.0)
        between("meta_controller_agent.batch_size", self.batch_size, 1, 65536)
        between("meta_controller_agent.buffer_size", self.buffer_size, self.batch_size, 1e8)
        between("meta_controller_agent.learning_rate", self.learning_rate, 0.0, 1.0)
        between("meta_controller_agent.tau", self.tau, 0.0, 1.0)
        between("meta_controller_agent.ema_rate", self.ema_rate, 1e-6, 1.0)
        between("meta_controller_agent.gamma", self.gamma, 0.0, 1.0)
        widths("meta_controller_agent.hidden", self.hidden)
        between("meta_controller_agent.exploration_start", self.exploration_start, 0.0, 1.0)
        between("meta_controller_agent.exploration_end", self.exploration_end, 0.0, 1.0)
        between("meta_controller_agent.log_every", self.log_every, 1, 1e9)
