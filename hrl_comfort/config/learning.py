"""Configuration of the curriculum and of the learner."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from hrl_comfort.config.checks import ConfigError, Widths, between, choice, named, own_keys, unique, within


@dataclass(frozen=True)
class StageConfig:
    """One curriculum stage of a training. The fields with a default are those that a list in YAML may leave out."""

    name: Annotated[str, Field(pattern=r"^[\w.-]+$")]
    """Written to the column `stage` of metrics.csv."""
    policy_steps: Annotated[int, within(1, 1e9)]
    """Policy calls of this stage, over all environments."""
    set: dict[str, Any] = field(default_factory=dict)
    """Values by their dotted keys (`reward.pick: 20`), in force in this stage alone."""
    replay: Annotated[str, choice("keep", "clear")] = "clear"
    """`clear` empties the replay buffer at the start of the stage; `keep` keeps it, old rewards included."""
    optimiser: Annotated[str, choice("keep", "fresh")] = "fresh"
    """`fresh` resets the optimiser's moments at the start of the stage; `keep` keeps them."""


Reach = Annotated[list[Annotated[float, within(0.0, 100.0)]], Field(min_length=2, max_length=2)]


@dataclass(frozen=True)
class CurriculumConfig:
    """Precision schedule and stages of a training.

    `task.precision.grasp_tolerance_m` follows the schedule; place and home keep their ratio to it.
    """

    stages: list[StageConfig]
    """Curriculum stages in order; []: one stage of `agent.policy_steps`."""
    kind: Annotated[str, choice("off", "linear", "adaptive")]
    """Precision schedule."""
    start_m: Annotated[float, within(0.005, 0.5)]
    """First grasp tolerance, at least `end_m`."""
    end_m: Annotated[float, within(0.005, 0.5)]
    """Last grasp tolerance."""
    step_m: Annotated[float, within(0.001, 0.5)]
    """`adaptive`: reduction of the tolerance at one tightening."""
    threshold: Annotated[float, within(0.0, 1.0)]
    """`adaptive`: precision tightens when the last `window` episodes have this success rate."""
    window: Annotated[int, within(1, 100_000)]
    """`adaptive`: number of episodes."""
    fraction: Annotated[float, within(0.01, 1.0)]
    """`linear`: share of the curriculum stage after which `end_m` is reached."""
    reach: Reach | None
    """With a gripper, where tasks begin that begin with a pick: anywhere up to this part of the way from in front of
    the object to home, at `start_m` and at `end_m`; beyond 1 more of them begin at home. null: as `task.start` says."""

    def __post_init__(self) -> None:
        between("curriculum.start_m", self.start_m, self.end_m, 0.5)
        names = [stage.name for stage in self.stages]
        if len(set(names)) < len(names):
            raise ConfigError(f"curriculum.stages are named {', '.join(names)}; give each a name of its own")


@dataclass(frozen=True)
class NoKeys:
    """A learner without keys of its own."""


@dataclass(frozen=True)
class TQCKeys:
    """Truncated quantile critics (Kuznetsov et al. 2020, arXiv:2005.04269)."""

    critics: Annotated[int, within(1, 100)] = 5
    """Number of critics."""
    quantiles: Annotated[int, within(2, 1000)] = 25
    """Number of quantiles of the return that each critic predicts."""
    dropped: Annotated[int, within(0, 999)] = 2
    """Number of the highest quantiles, for each critic, that targets leave out; fewer than `quantiles`."""

    def __post_init__(self) -> None:
        between("dropped", self.dropped, 0, self.quantiles - 1)


@dataclass(frozen=True)
class CrossQKeys:
    """Critics with batch normalisation and without targets (Bhatt et al. 2024, arXiv:1902.05605)."""

    critic_hidden: Widths = field(default_factory=lambda: [512, 512])
    """Widths of the hidden layers of the critics."""
    momentum: Annotated[float, within(1e-6, 1.0)] = 0.01
    """Weight of the latest batch in the running statistics of batch renormalisation (Ioffe 2017, arXiv:1702.03275)."""
    warmup_updates: Annotated[int, within(0, 1e9)] = 10_000
    """Number of updates with plain batch normalisation."""
    updates_per_actor_update: Annotated[int, within(1, 1000)] = 3
    """Number of updates of the critics for each of the actor."""


@dataclass(frozen=True)
class REDQKeys:
    """Randomised ensembled double Q-learning (Chen et al. 2021, arXiv:2101.05982)."""

    critics: Annotated[int, within(1, 100)] = 10
    """Number of critics; the actor climbs their mean."""
    subset: Annotated[int, within(1, 100)] = 2
    """Number of target critics, drawn in each update, whose least value is the target; at most `critics`."""
    updates_per_actor_update: Annotated[int, within(1, 1000)] = 4
    """Number of updates of the critics for each of the actor."""

    def __post_init__(self) -> None:
        between("subset", self.subset, 1, self.critics)


@dataclass(frozen=True)
class HeldKeys:
    """Soft actor-critic whose exploration lasts (Nachum et al. 2019, arXiv:1909.10618)."""

    hold: Annotated[int, within(1, 10_000)] = 10
    """Number of decisions for which the noise of exploration, or a random action, stays the same."""


def _column(value: Any) -> Any:
    number = isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= LAST_COLUMN
    if not number and not (isinstance(value, str) and value):
        raise ConfigError(f"={value!r} is neither a column, 0 to {LAST_COLUMN}, nor the name of some: joint_error, say")
    return value


LAST_COLUMN = 1_000_000
Columns = Annotated[list[Annotated[int | str, BeforeValidator(_column)]], unique]
"""Columns of the observation: numbers, from 0 on, and names of its parts, which stand for all columns of each."""


@dataclass(frozen=True)
class HIROKeys:
    """Goals from an upper policy (Nachum et al. 2018, arXiv:1805.08296)."""

    goals: Columns = field(default_factory=lambda: ["joint_error"])
    """Columns of the observation that goals are set in, by number or by the name of a part of it; []: all."""
    reach: Annotated[float, within(1e-6, 1e6)] = 0.5
    """Farthest goal in a column, from its value at the time, in its unit. That of `joint_error` is π: at 2 degrees a
    control step a joint turns by 0.56 at most in ten decisions."""
    every: Annotated[int, within(1, 1000)] = 10
    """Number of decisions after which the upper policy sets the next goal, and of updates of the lower policy for each
    of the upper."""
    candidates: Annotated[int, within(2, 100)] = 10
    """Number of goals from which a past one is replaced by that which best explains the actions taken."""


@dataclass(frozen=True)
class OptionCriticKeys:
    """Options with learned policies and terminations (Bacon et al. 2017, arXiv:1609.05140), here on soft critics."""

    options: Annotated[int, within(1, 64)] = 4
    """Number of options."""
    deliberation_cost: Annotated[float, within(0.0, 1000.0)] = 0.01
    """Advantage that a termination must bring (Harb et al. 2018, arXiv:1709.04571)."""
    exploration: Annotated[float, within(0.0, 1.0)] = 0.1
    """Probability, where an option ends, that the next is drawn at random."""


@dataclass(frozen=True)
class EndToEndKeys:
    """Skills of a chain that learn together in the whole task."""

    skills: Annotated[list[str], unique, Field(min_length=1)] = field(
        default_factory=lambda: ["pick", "place", "return"]
    )
    """Skills in the order of the stages; each begins with the policy in the folder of its name in `initial_policy`."""
    stages: Columns = field(default_factory=lambda: ["stage"])
    """Columns of the observation that tell which stage is in force, by number or name; no skill sees them."""


SKILL_LEARNERS: dict[str, type] = {
    "sac": NoKeys, "tqc": TQCKeys, "crossq": CrossQKeys, "redq": REDQKeys, "held": HeldKeys,
}  # fmt: skip
"""Built-in learners of skills, each with the dataclass of its own keys."""
BASELINES: dict[str, type] = {"hiro": HIROKeys, "option_critic": OptionCriticKeys, "end_to_end": EndToEndKeys}
"""Built-in learners whose policy has a hierarchy of its own, likewise."""
LEARNERS = {**SKILL_LEARNERS, **BASELINES}


@dataclass(frozen=True)
class AgentConfig:
    """The learner of a skill, by default soft actor-critic (Haarnoja et al. 2018, arXiv:1812.05905)."""

    name: Annotated[str, named("agent.name", *LEARNERS)]
    """A built-in learner, one that an installed package offers as an entry point (both by name), or
    `package.module:Class`."""
    own: dict[str, Any]
    """Keys that only this learner has."""
    policy_steps: Annotated[int, within(1, 1e9)]
    """Policy calls to train for, over all environments. With `curriculum.stages` the default is the sum of the stages'
    `policy_steps`; another value lengthens or shortens all stages in proportion."""
    learning_starts: Annotated[int, within(0, 1e8)]
    """Policy steps with random actions before the first update."""
    updates_per_policy_step: Annotated[float, within(0.0, 16.0)]
    """Number of updates for each policy step."""
    critic_warmup_updates: Annotated[int, within(0, 1e9)]
    """Number of updates, at the beginning of a training or curriculum stage, that change the critics alone, so that
    these know the stage's rewards before the actor changes."""
    batch_size: Annotated[int, within(1, 65536)]
    """Number of transitions in a batch."""
    buffer_size: int
    """Capacity of the replay buffer in transitions, at least `batch_size`."""
    learning_rate: Annotated[float, within(0.0, 1.0)]
    """Learning rate of Adam."""
    learning_rate_end: Annotated[float, within(0.0, 1.0)] | None
    """Learning rate at the end of the curriculum stage, reached linearly; null keeps `learning_rate`."""
    critic_layer_norm: bool
    """Layer normalisation in the critics (Ba et al. 2016, arXiv:1607.06450)."""
    tau: Annotated[float, within(0.0, 1.0)]
    """Update rate of the target critics."""
    ema_rate: Annotated[float, within(1e-6, 1.0)]
    """Weight of the latest actor in the moving average that is saved (Polyak and Juditsky 1992); 1 saves the latest."""
    gamma: Annotated[float, within(0.0, 1.0)]
    """Discount factor of a control step; a decision of k steps has gamma**k."""
    hidden: Widths
    """Widths of the hidden layers."""
    entropy_coefficient: Annotated[float, within(1e-8, 100.0)]
    """Initial value of the entropy coefficient, which is learned."""
    target_entropy: Annotated[float, within(-1000.0, 1000.0)]
    """Target entropy, nats."""
    normalise: bool
    """Normalise observations by their running mean and variance."""
    device: Annotated[str, choice("cpu", "cuda")]
    """Device of the networks and the replay buffer; the simulation runs on the CPU."""
    matmul_precision: Annotated[str, choice("highest", "high", "medium")]
    """Inner precision of float32 matrix products (`torch.set_float32_matmul_precision`)."""
    demonstrator: str | None
    """Policy that acts in the first `demonstrator_envs` environments, and that the actor imitates: whatever `policy=`
    takes, but not `random`; null is none."""
    demonstrator_envs: Annotated[int, within(0, 65535)]
    """Number of environments, of `engine.num_envs`, in which the demonstrator acts; metrics.csv leaves them out."""
    demonstrator_takeover: Annotated[float, within(1e-3, 1.0)]
    """Probability, at each decision, that the demonstrator takes over an episode from the actor (Ross and Bagnell 2014,
    arXiv:1406.5979); at 1 it acts from the beginning. Less shows how to go on from where the actor gets to."""
    other_level: Annotated[float, within(0.0, 1.0)]
    """Probability that a transition is stored at a comfort level drawn anew, with the comfort reward of that level, so
    that what is done at one level teaches the others. Demonstrations keep theirs."""
    bc_weight: Annotated[float, within(0.0, 1e6)]
    """Weight of the actor's squared distance from the demonstrator's actions, where the critics rate these higher than
    the actor's own."""
    next_skill: str | None
    """Run folder of the policy that acts after a success, read when a stage begins or is resumed. The value that
    its critics give to the state at the success is discounted and added to the target of the critics being trained."""
    next_skill_reward: Annotated[float, within(0.0, 1e6)]
    """Reward for a success that ends in a state from which `next_skill` has succeeded, as a discriminator tells them,
    in place of the value that its critics give (Lee et al. 2021, arXiv:2111.07999); less for other states. 0: that
    value."""
    log_every: Annotated[int, within(1, 1e9)]
    """Policy steps between two rows of metrics.csv."""
    checkpoint_every: Annotated[int, within(1, 1e9)]
    """Policy steps between two checkpoints."""
    keep_checkpoints: Annotated[int, within(1, 1000)]
    """Number of checkpoints to keep."""

    def __post_init__(self) -> None:
        between("agent.buffer_size", self.buffer_size, self.batch_size, 1e8)
        if self.name in LEARNERS:
            own: Any = own_keys("agent", self.name, LEARNERS[self.name], self.own)
            object.__setattr__(self, "own", asdict(own))  # with its defaults, so that config.yaml has all
        if (self.demonstrator is None) != (self.demonstrator_envs == 0):
            raise ConfigError(
                f"agent.demonstrator_envs={self.demonstrator_envs} does not go with "
                f"agent.demonstrator={self.demonstrator}; give both, or null and 0"
            )
