"""Configuration of the meta-controller above the options, and of its learner."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any

from hrl_comfort.config.checks import ConfigError, Widths, between, choice, named, own_keys, unique, within
from hrl_comfort.config.learning import NoKeys
from hrl_comfort.config.task import SORTING

RULES = ("nearest", "free", "due", "greedy", "cautious", "patient")
"""Built-in meta-controllers that work, by a function of a decision."""
TOPS = (*RULES, "idle", "fixed", "random", "learned")
ORACLE, LOOKAHEAD = "oracle", "lookahead"
"""Built-in meta-controllers; the oracle knows what people will do, `lookahead` how they walk."""
STEADY = ("none", "fixed", "random")
"""Sources of comfort levels that do not change within an episode."""
META_OBSERVATIONS = ("default", "jobs", "habits")
OBSERVED = {"default": (18, 9), "jobs": (15, 12), "habits": (15, 20)}
"""Numbers that a top observes of all, and of each object, by META_OBSERVATIONS."""
CYCLE = ("pick", "place", "return")
"""Skills of the tasks SORTING."""
FURTHER_OPTIONS = "meta_controller.further_options"
OPTION_KEYS: dict[str, Any] = {
    "level_override": [], "max_waits": None, "interruption_steps": None, "further_options": [],
}  # fmt: skip
"""Keys of the options, with the values that change nothing; a learned controller keeps those it had."""


@dataclass(frozen=True)
class MetaControllerConfig:
    """The meta-controller, which sequences frozen policies."""

    name: Annotated[str, named("meta_controller.name", "none", *TOPS, ORACLE, LOOKAHEAD)]
    """A built-in controller, one that an installed package offers as an entry point (both by name), or
    `package.module:name`; `none` runs the one policy of `policy=`."""
    options: list[str]
    """Subtasks in the order of the cycle."""
    time_limit_steps: Annotated[int, within(1, 100_000)]
    """Control steps after which an option is preempted, by default `task.max_option_steps`. The options `wait`
    (stand still for 0.5 s) and `retreat` (go home) are not bound by it. If `comfort.source` is not `none` and
    `comfort.beta` is above 0, the limit is multiplied by `comfort.levels` / level."""
    interruption_steps: Annotated[int, within(1, 100_000)] | None
    """`sort`, `shift`, `kitting`: control steps after which a skill or `retreat` is interrupted, so that the controller
    decides whether it goes on; null: never. A `learned` controller keeps the value of its training; any other is
    refused."""
    retries: Annotated[int, within(0, 100)]
    """Number of times in a row that an option which ran out of time may be started again before the episode is given
    up. In `sort`, `shift` and `kitting` there is no limit."""
    max_waits: Annotated[int, within(0, 100_000)] | None
    """`sort`, `shift`, `kitting`: number of times in a row that `wait` can be chosen; null: any number. The default of
    `cautious` is 6. A `learned` controller is evaluated with the value of its training; any other is refused."""
    level_override: Annotated[list[Annotated[int, within(1, 1000)]], unique]
    """`sort`, `shift`, `kitting`: comfort levels that the controller may give a skill (the policy of an option) instead
    of the current level. `nearest`, `free`, `due`, `greedy`, `cautious`, `patient` and `fixed` give every skill the
    first of them."""
    further_options: Annotated[list[Annotated[str, named(FURTHER_OPTIONS)]], unique]
    """Options of your own beside those of the task: each `package.module:name`, or the name of one that an installed
    package offers as an entry point."""
    order: Annotated[list[str], unique]
    """`fixed`: names of options, the first choice first; those that are not named come after them."""

    def alone(self) -> MetaControllerConfig:
        """Return the section for a policy without a controller."""
        return replace(self, name="none", **OPTION_KEYS, order=[])

    def check(self, task: str) -> None:
        """Raise ConfigError if a key is set that this controller does not read, or a chain is interrupted."""
        for key, off in OPTION_KEYS.items():
            unread = self.name in ("none", "idle") or (key == "interruption_steps" and task not in SORTING)
            if unread and (value := getattr(self, key)) != off:
                chain = " or a chain" if key == "further_options" else ""
                raise ConfigError(
                    f"meta_controller.{key}={value} is for a controller of skills in task={', '.join(SORTING)}{chain}, "
                    f"not for meta_controller={self.name} in task={task}; choose {'null' if off is None else off}"
                )
        if self.order and self.name != "fixed":
            raise ConfigError(
                f"meta_controller.order={self.order} is for meta_controller=fixed, not for {self.name}; choose []"
            )

    def check_policies(self, task: str, policies: Iterable[str], further: Sequence[str] = ()) -> None:
        """Raise ConfigError if one of `policies` is of no skill that this controller has in `task`, nor `further`."""
        parts = [*(CYCLE if task in SORTING else self.options), *further]
        if odd := [name for name in policies if name not in parts]:
            raise ConfigError(
                f"policies.{odd[0]} is not used by meta_controller={self.name} in task={task}; its parts are "
                f"{', '.join(parts)}"
            )


@dataclass(frozen=True)
class DiscreteSACKeys:
    """Soft actor-critic over options (Christodoulou 2019, arXiv:1910.07207)."""

    entropy_coefficient: Annotated[float, within(1e-8, 100.0)] = 0.1
    """Initial value of the entropy coefficient, which is learned."""
    target_entropy: Annotated[float, within(0.0, 100.0)] = 0.3
    """Target entropy, nats, over the options that can start."""


@dataclass(frozen=True)
class PPOKeys:
    """Proximal policy optimisation over options (Schulman et al. 2017, arXiv:1707.06347)."""

    rollout: Annotated[int, within(2, 1e6)] = 1024
    """Number of options after which the policy is updated."""
    epochs: Annotated[int, within(1, 1000)] = 8
    """Number of passes over a rollout, each in batches of `batch_size`."""
    clip: Annotated[float, within(1e-3, 1.0)] = 0.2
    """Largest change of a probability, as a share of it, that an update still pursues."""
    gae_lambda: Annotated[float, within(0.0, 1.0)] = 0.95
    """Weight of the next option's advantage (Schulman et al. 2016, arXiv:1506.02438)."""
    entropy_weight: Annotated[float, within(0.0, 10.0)] = 0.01
    """Weight of the entropy in the loss."""
    value_weight: Annotated[float, within(0.0, 100.0)] = 0.5
    """Weight of the critic in the loss."""


TOP_LEARNERS: dict[str, type] = {"dqn": NoKeys, "discrete_sac": DiscreteSACKeys, "ppo": PPOKeys}
"""Built-in learners of a top, each with the dataclass of its own keys."""


@dataclass(frozen=True)
class MetaControllerAgentConfig:
    """The learner of a top, by default double DQN over options (van Hasselt, Guez, Silver 2016)."""

    name: Annotated[str, named("meta_controller_agent.name", *TOP_LEARNERS)]
    """A built-in learner, one that an installed package offers as an entry point (both by name), or
    `package.module:Class`."""
    own: dict[str, Any]
    """Keys that only this learner has."""
    observation: Annotated[str, choice(*META_OBSERVATIONS)]
    """The person in the observation: position and facing (`default`), or nearness to the tool (`jobs`). Both have the
    person's distance from each object and from where it belongs, `jobs` also how fast both shrink, for the person
    nearest to each, and the time until each order is due. `habits` is `jobs` with which way round the robot that
    person last walked and how long ago, and how far the robot has to turn."""
    options: Annotated[int, within(1, 1e9)]
    """Length of the training: number of choices of an option, over all cells; at an interruption there is one."""
    warmup_options: Annotated[int, within(0, 1e9)]
    """Random options before the first update."""
    updates_per_option: Annotated[float, within(0.0, 16.0)]
    """Number of updates of the network for each run of an option."""
    batch_size: Annotated[int, within(1, 65536)]
    """Number of options in a batch."""
    buffer_size: int
    """Capacity of the replay buffer in options, at least `batch_size`."""
    learning_rate: Annotated[float, within(0.0, 1.0)]
    """Learning rate of Adam."""
    tau: Annotated[float, within(0.0, 1.0)]
    """Update rate of the target network."""
    ema_rate: Annotated[float, within(1e-6, 1.0)]
    """Weight of the latest network in the moving average that is saved; 1 saves the latest."""
    gamma: Annotated[float, within(0.001, 1.0)]
    """Discount factor of a control step; an option of k steps has gamma**k."""
    n_step: Annotated[int, within(1, 100)]
    """Number of choices whose discounted rewards count before the value of the observation after them (n-step returns,
    not corrected for other policies; with `discrete_sac` without the entropy in between). `ppo` takes 1: its advantages
    look ahead by `own.gae_lambda`."""
    hidden: Widths
    """Widths of the hidden layers."""
    network: Annotated[str, choice("flat", "shared")]
    """Network of the scores of the built-in learners: one of all observations (`flat`), or one that scores every object
    alike, from what is observed of it and of all together (`shared`): what it learns of one object holds for all."""
    exploration_start: Annotated[float, within(0.0, 1.0)]
    """Probability of a random option at the start."""
    exploration_end: Annotated[float, within(0.0, 1.0)]
    """Probability of a random option in the second half of the training; in the first half it goes linearly from
    `exploration_start` to this, and during `warmup_options` it is 1."""
    rule: Annotated[str, choice(*RULES)] | None
    """Rule that chooses in the first `rule_envs` environments; the learner learns from what comes of it, too;
    null is none. `ppo` takes none: it learns from its own choices alone."""
    rule_envs: Annotated[int, within(0, 65535)]
    """Number of environments, of `engine.num_envs`, in which the rule chooses. Their options count among `options` and
    in the loss; meta_controller_metrics.csv leaves out their episodes and shares of time."""
    log_every: Annotated[int, within(1, 1e9)]
    """Options between two rows of meta_controller_metrics.csv, and between two checkpoints."""

    def __post_init__(self) -> None:
        between("meta_controller_agent.buffer_size", self.buffer_size, self.batch_size, 1e8)
        if (self.rule is None) != (self.rule_envs == 0):
            raise ConfigError(
                f"meta_controller_agent.rule={self.rule} does not go with "
                f"meta_controller_agent.rule_envs={self.rule_envs}; give both or neither"
            )
        if self.rule is not None and self.name == "ppo":
            raise ConfigError(
                f"meta_controller_agent.rule={self.rule} does not go with meta_controller_agent=ppo, "
                "which learns from its own choices alone; choose null, or dqn or discrete_sac"
            )
        if self.n_step > 1 and self.name == "ppo":
            raise ConfigError(
                f"meta_controller_agent.n_step={self.n_step} does not go with meta_controller_agent=ppo, "
                "whose advantages look ahead; choose 1, or dqn or discrete_sac"
            )
        if self.name in TOP_LEARNERS:
            own: Any = own_keys("meta_controller_agent", self.name, TOP_LEARNERS[self.name], self.own)
            object.__setattr__(self, "own", asdict(own))  # with its defaults, so that config.yaml has all


def check_ahead(top: str, motions: set[str], source: str, disturbance: str) -> None:
    """Raise ConfigError if `top` looks ahead, and copies of the cell do not know what people do.

    Likewise if `lookahead` would know ahead what people, comfort levels or disturbances do.
    """
    if top == ORACLE and "live" in motions:
        raise ConfigError(
            f"human.motion=live: meta_controller={ORACLE} and regret=true need copies that know what people will do; "
            "choose another motion"
        )
    if top != LOOKAHEAD:
        return
    for said, known, remedy in (
        ("human.motion", motions & {"recorded", "live"}, "another motion"),
        ("comfort.source", {source} - {*STEADY}, ", ".join(STEADY)),
        ("disturbance", {disturbance} - {"none"}, "none"),
    ):
        if known:
            raise ConfigError(
                f"{said}={min(known)}: meta_controller={LOOKAHEAD} would know ahead what it does; choose {remedy}"
            )
