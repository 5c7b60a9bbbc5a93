"""Learners by name: what a training needs of one, those built in, and those of users."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import is_dataclass, replace
from functools import partial
from typing import Any, Protocol

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from hrl_comfort.agents.baselines.end_to_end import EndToEnd
from hrl_comfort.agents.baselines.held import Held
from hrl_comfort.agents.baselines.hiro import HIRO
from hrl_comfort.agents.baselines.option_critic import OptionCritic
from hrl_comfort.agents.crossq import CrossQ
from hrl_comfort.agents.redq import REDQ
from hrl_comfort.agents.sac import SAC
from hrl_comfort.agents.tops.discrete_sac import DiscreteSAC
from hrl_comfort.agents.tops.dqn import DQN
from hrl_comfort.agents.tops.options import OptionLearner
from hrl_comfort.agents.tops.ppo import PPO
from hrl_comfort.agents.tqc import TQC
from hrl_comfort.config import AgentConfig, ConfigError, MetaControllerAgentConfig
from hrl_comfort.config.checks import implemented, own_keys, part, takes
from hrl_comfort.config.hierarchy import TOP_LEARNERS
from hrl_comfort.config.learning import BASELINES, SKILL_LEARNERS, NoKeys

METHODS = {
    "act": ("now", "exploration"), "observe": ("transitions",), "update": (), "state_dict": (),
    "load_state_dict": ("state",),
}  # fmt: skip
"""Methods of a learner, and their arguments."""


class Learner(Protocol):
    """Chooses actions and learns from what follows; its state is plain data.

    The class is called with its configuration, the sizes of observations and actions, and its own keys: a `Keys` of
    this class, a dataclass with defaults. `policy` is a module that the run keeps: for a skill from raw observations
    (N, D) to actions (N, A) in [-1, 1], for a top from observations to scores (N, K) of the options, of which the
    greatest is chosen. That of a skill with memory has `memory_dim`, and takes and returns a memory (N, M) too, zeros
    at the beginning of an episode. `terms`, if any, names the columns of metrics.csv that `update` fills; of a top, it
    is `loss`. A class with `terminal_value` adds what that says to the rewards that it samples, as agents.sac does;
    `agent.next_skill_reward` needs it.
    """

    def act(self, now: TensorDictBase, exploration: float) -> Tensor:
        """Return actions (N, …); `exploration` is the probability of one at random, whatever the policy says."""

    def observe(self, transitions: TensorDictBase) -> None:
        """Store transitions (F,), of `meta_controller_agent.n_step` choices each; F may be 0."""

    def update(self) -> dict[str, float]:
        """Learn once, and return terms by column; none where too little has been observed for that."""

    def state_dict(self) -> dict[str, Any]: ...  # noqa: D102
    def load_state_dict(self, state: dict[str, Any]) -> None: ...  # noqa: D102


SKILLS: dict[str, type[SAC]] = implemented(
    tuple(SKILL_LEARNERS), {"sac": SAC, "tqc": TQC, "crossq": CrossQ, "redq": REDQ, "held": Held}
)
"""Built-in learners of skills."""
HIERARCHICAL: dict[str, type[Learner]] = implemented(
    tuple(BASELINES), {"hiro": HIRO, "option_critic": OptionCritic, "end_to_end": EndToEnd}
)
"""Built-in learners whose policy has a hierarchy of its own."""
TOPS: dict[str, type[OptionLearner]] = implemented(
    tuple(TOP_LEARNERS), {"dqn": DQN, "discrete_sac": DiscreteSAC, "ppo": PPO}
)
"""Built-in learners of tops."""
KNOWN: dict[str, dict[str, Any]] = {"agent": {**SKILLS, **HIERARCHICAL}, "meta_controller_agent": {**TOPS}}
"""Built-in learners by the section of their configuration."""


def learner_class(key: str, name: str) -> type:
    """Return the class of the learner that `KEY.name` names: a built-in one, an entry point or `package.module:Class`.

    Raises:
      ConfigError: it is not there, or lacks one of METHODS.
    """
    found: Any = part(f"{key}.name", name, KNOWN[key])
    if missing := [method for method in METHODS if not callable(getattr(found, method, None))]:
        raise ConfigError(f"{key}.name={name!r} has no {missing[0]}; a learner has {', '.join(METHODS)}")
    if not isinstance(found, type):
        raise ConfigError(f"{key}.name={name!r} is of type {type(found).__name__}; it must be a class")
    return found


def check_terminal_value(config: AgentConfig) -> None:
    """Raise ConfigError if successes have a reward that the class of the learner has no `terminal_value` to ask for."""
    if config.next_skill_reward and not hasattr(learner_class("agent", config.name), "terminal_value"):
        able = [name for name, kind in KNOWN["agent"].items() if hasattr(kind, "terminal_value")]
        raise ConfigError(
            f"agent.next_skill_reward={config.next_skill_reward:g} does not go with agent.name={config.name!r}, which "
            f"has no terminal_value; choose 0, {', '.join(able)}, or a class with that attribute"
        )


def with_columns(config: AgentConfig, layout: Mapping[str, range]) -> AgentConfig:
    """Return the configuration with the own keys that are `columns` of a built-in learner as numbers, by `layout`.

    Raises:
      ConfigError: a name is not one of the layout.
    """
    own = dict(config.own)
    for key in getattr(KNOWN["agent"].get(config.name), "columns", ()):
        for each in own[key]:
            if isinstance(each, str) and each not in layout:
                has = f"the observation has {', '.join(layout)}" if layout else "no part of the observation has a name"
                raise ConfigError(f"agent.own.{key}={own[key]}: {has}; choose other names, or numbers of columns")
        own[key] = [number for each in own[key] for number in (layout[each] if isinstance(each, str) else [each])]
    return replace(config, own=own)


def make_learner(
    key: str, config: AgentConfig | MetaControllerAgentConfig, observation_dim: int, actions: int
) -> Any:  # fmt: skip
    """Return the learner of a training, the section `key` of its configuration, for actions of a size or a number.

    Raises:
      ConfigError: it is not there, has other keys, or keeps no policy.
    """
    kind, named, built_in = learner_class(key, config.name), f"{key}.name={config.name!r}", config.name in KNOWN[key]
    keys = getattr(kind, "Keys", NoKeys)
    if not built_in:
        if not is_dataclass(keys):
            raise ConfigError(f"{named}: Keys must be a dataclass")
        takes(named, kind, "config, observation_dim, actions, own")
        for method, arguments in METHODS.items():
            takes(f"{named}: {method}", getattr(kind, method), ", ".join(["self", *arguments]))
    own = own_keys(key, config.name, keys, config.own)
    made = kind(config, observation_dim, actions, own)
    if not built_in:
        _check_policy(named, getattr(made, "policy", None), observation_dim, actions)
        made.act = partial(_acted, named, made.act, actions)
    return made


def _acted(named: str, act: Callable[..., Any], actions: int, now: TensorDictBase, exploration: float) -> Tensor:
    """Return what a learner of users chooses: actions (N, A), or of a top options (N,) that can start.

    Raises:
      ConfigError: it is something else.
    """
    action, rows, mask = act(now, exploration), len(now), now.get("action_mask", None)
    said = f"{action.dtype} of shape {tuple(action.shape)}" if isinstance(action, Tensor) else type(action).__name__
    said = f"{named}: act returned {said.removeprefix('torch.')}"
    if mask is None:
        shaped = isinstance(action, Tensor) and action.shape == (rows, actions) and action.is_floating_point()
        if not shaped or not bool(action.isfinite().all()):
            raise ConfigError(f"{said}; it must return finite floats of shape ({rows}, {actions})")
        return action
    if not isinstance(action, Tensor) or action.shape != (rows,) or action.dtype != torch.int64:
        raise ConfigError(f"{said}; it must return int64 of shape ({rows},)")
    able = mask.gather(1, action.clamp(0, actions - 1)[:, None]).squeeze(1) & (action >= 0) & (action < actions)
    if bool((odd := now["deciding"].reshape(-1) & ~able).any()):
        row = int(torch.nonzero(odd)[0])
        can = ", ".join(map(str, torch.nonzero(mask[row]).squeeze(-1).tolist()))
        raise ConfigError(f"{named}: act chose option {int(action[row])} in row {row}, which cannot start; {can} can")
    return action


def _check_policy(named: str, policy: Any, observation_dim: int, actions: int) -> None:
    """Raise ConfigError unless `policy` is a module that returns `actions` finite numbers for an observation."""
    if not isinstance(policy, nn.Module):
        raise ConfigError(f"{named} has no policy, a torch module of observations")
    memory, trains = getattr(policy, "memory_dim", None), policy.training
    given = [torch.zeros(1, width) for width in (observation_dim, memory) if width is not None]
    with torch.no_grad(), torch.random.fork_rng(devices=[]):
        try:
            found = policy.eval()(*given)
        except (RuntimeError, TypeError, ValueError) as error:
            said = str(error).splitlines()[0]
            raise ConfigError(f"{named}: policy of {observation_dim} observations failed: {said}") from error
        finally:
            policy.train(trains)
    action = found if memory is None else found[0]
    if not isinstance(action, Tensor) or action.shape != (1, actions) or not action.isfinite().all():
        said = str(tuple(action.shape)) if isinstance(action, Tensor) else type(action).__name__
        raise ConfigError(f"{named}: policy returned {said}; it must return finite numbers of shape (1, {actions})")
