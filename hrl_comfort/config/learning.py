"""How a policy is taught."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any

from hrl_comfort.config.checks import ConfigError, between, one_of, widths

CURRICULA = ("off", "linear", "adaptive")
DEVICES = ("cpu", "cuda")
MATMUL_PRECISIONS = ("highest", "high", "medium")


@dataclass(frozen=True)
class StageConfig:
    """One stage of a training. The fields with a default are those that a list in YAML may leave out."""

    name: str
    """Written to the column `stage` of metrics.csv."""
    policy_steps: int
    """Policy calls of this stage, over all environments."""
    set: dict[str, Any] = field(default_factory=dict)
    """Values by their dotted keys (`reward.pick: 20`), in force in this stage alone."""
    replay: str = "clear"
    """`clear` empties the replay buffer as the stage begins; `keep` goes on with it, old rewards included."""
    optimiser: str = "fresh"
    """`fresh` forgets the optimiser's moments as the stage begins; `keep` goes on with them."""

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[\w.-]+", self.name):
            raise ConfigError(f"curriculum.stages: name={self.name!r} must be letters, digits and ._- only")
        between(f"curriculum.stages ({self.name}): policy_steps", self.policy_steps, 1, 1e9)
        one_of(f"curriculum.stages ({self.name}): replay", self.replay, ("keep", "clear"))
        one_of(f"curriculum.stages ({self.name}): optimiser", self.optimiser, ("keep", "fresh"))


@dataclass(frozen=True)
class CurriculumConfig:
    """Precision schedule and stages of a training.

    `task.precision.grasp_tolerance_m` follows the schedule; place and home keep their ratio to it.
    """

    stages: list[StageConfig]
    """In the order in which they are trained; none: one stage of `agent.policy_steps`."""

    kind: str
    start_m: float
    end_m: float
    step_m: float
    """`adaptive`: how much one tightening takes off."""
    threshold: float
    """`adaptive`: success share over the last `window` episodes that tightens."""
    window: int
    fraction: float
    """`linear`: share of the stage after which `end_m` is reached."""

    def __post_init__(self) -> None:
        names = [stage.name for stage in self.stages]
        if len(set(names)) < len(names):
            raise ConfigError(f"curriculum.stages are named {', '.join(names)}; give each a name of its own")
        one_of("curriculum.kind", self.kind, CURRICULA)
        between("curriculum.end_m", self.end_m, 0.005, 0.5)
        between("curriculum.start_m", self.start_m, self.end_m, 0.5)
        between("curriculum.step_m", self.step_m, 0.001, 0.5)
        between("curriculum.threshold", self.threshold, 0.0, 1.0)
        between("curriculum.window", self.window, 1, 100_000)
        between("curriculum.fraction", self.fraction, 0.01, 1.0)


@dataclass(frozen=True)
class AgentConfig:
    """Soft actor-critic (Haarnoja et al. 2018), the paper's network and rates by default."""

    policy_steps: int
    """Policy calls to train for, over all rows."""
    learning_starts: int
    """Uniformly random decisions before the first update."""
    updates_per_policy_step: float
    critic_warmup_updates: int
    """Updates in which the critics learn alone. Where training goes on from a policy under other rewards, the
    old critics would spoil it first."""
    batch_size: int
    buffer_size: int
    learning_rate: float
    learning_rate_end: float | None
    """The learning rate falls linearly to this over the stage; null keeps it."""
    critic_layer_norm: bool
    """Layer normalisation in the critics (Ba et al. 2016, arXiv:1607.06450)."""
    tau: float
    ema_rate: float
    """Share of the newest actor, at each update, in the mean that policy files keep (Polyak and Juditsky
    1992); 1 keeps the newest."""
    gamma: float
    """Discount per control step; a decision of k steps discounts by gamma**k."""
    hidden: list[int]
    entropy_coefficient: float
    """Initial value; it is learned from there."""
    target_entropy: float
    normalise: bool
    device: str
    """Where the learner's networks and buffer live; the cells are simulated on the CPU."""
    matmul_precision: str
    """Inner precision of the learner's float32 matrix products (`torch.set_float32_matmul_precision`)."""
    demonstrator: str | None
    """Policy that acts in `demonstrator_envs` environments: `potential_field`, `expert` or a run folder. Transitions
    go to the replay buffer like all others."""
    demonstrator_envs: int
    """Of `engine.num_envs`; they count in no success share and in no row of metrics.csv."""
    bc_weight: float
    """Weight of the actor's squared distance from the guide's action, where the critics prefer that."""
    next_skill: str | None
    """The policy that takes over where this one succeeds: what that is worth to it counts as well."""
    log_every: int
    """Decisions between two rows of metrics.csv."""
    checkpoint_every: int
    """Decisions between two checkpoints."""
    keep_checkpoints: int

    def __post_init__(self) -> None:
        between("agent.policy_steps", self.policy_steps, 1, 1e9)
        between("agent.learning_starts", self.learning_starts, 0, 1e8)
        between("agent.updates_per_policy_step", self.updates_per_policy_step, 0.0, 16.0)
        between("agent.critic_warmup_updates", self.critic_warmup_updates, 0, 1e9)
        between("agent.batch_size", self.batch_size, 1, 65536)
        between("agent.buffer_size", self.buffer_size, self.batch_size, 1e8)
        between("agent.learning_rate", self.learning_rate, 0.0, 1.0)
        if self.learning_rate_end is not None:
            between("agent.learning_rate_end", self.learning_rate_end, 0.0, 1.0)
        between("agent.tau", self.tau, 0.0, 1.0)
        between("agent.ema_rate", self.ema_rate, 1e-6, 1.0)
        between("agent.gamma", self.gamma, 0.0, 1.0)
        widths("agent.hidden", self.hidden)
        between("agent.entropy_coefficient", self.entropy_coefficient, 1e-8, 100.0)
        between("agent.target_entropy", self.target_entropy, -1000.0, 1000.0)
        one_of("agent.device", self.device, DEVICES)
        one_of("agent.matmul_precision", self.matmul_precision, MATMUL_PRECISIONS)
        between("agent.demonstrator_envs", self.demonstrator_envs, 0, 65535)
        if self.demonstrator == "":
            raise ConfigError("agent.demonstrator='' names nobody; say agent.demonstrator=null for none")
        if (self.demonstrator is None) != (self.demonstrator_envs == 0):
            raise ConfigError(
                f"agent.demonstrator_envs={self.demonstrator_envs} does not go with "
                f"agent.demonstrator={self.demonstrator}"
            )
        if self.next_skill == "":
            raise ConfigError("agent.next_skill='' names nobody; say agent.next_skill=null for none")
        between("agent.bc_weight", self.bc_weight, 0.0, 1e6)
        between("agent.log_every", self.log_every, 1, 1e9)
        between("agent.checkpoint_every", self.checkpoint_every, 1, 1e9)
        between("agent.keep_checkpoints", self.keep_checkpoints, 1, 1000)
