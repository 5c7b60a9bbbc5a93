"""What a training steps: an environment, who shows the way in some of its rows, and who goes on after it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from hrl_comfort.config import AgentConfig, ConfigError

Demonstrator = Callable[[], Tensor]
"""() -> the actions (guided rows, A) in [-1, 1] that a guide takes now."""
NextSkillValue = Callable[[Tensor], Tensor]
"""success (N,) bool of the latest decision -> value (N,) to the policy that takes over, 0 without success."""


@dataclass(frozen=True)
class Shape:
    """Of what is stepped."""

    rows: int
    observation_dim: int
    action_dim: int
    reward_names: tuple[str, ...]


@dataclass(frozen=True)
class Transition:
    """What a decision in each of N rows led to."""

    action: Tensor
    """(N, A): what was done, a guide's in its rows."""
    reward: Tensor
    """(N,)."""
    terminal_value: Tensor
    """(N,): what a success is worth beside, as the policy that takes over values it."""
    next_observation: Tensor
    """(N, D), before a row begins anew."""
    observation: Tensor
    """(N, D): what the next decision is made on."""
    reward_terms: Tensor
    """(N, T)."""
    success: Tensor
    """(N,) bool, as are the next four."""
    terminated: Tensor
    done: Tensor
    human_collision: Tensor
    other_collision: Tensor
    steps: Tensor
    """(N,) int64: control steps in the episode."""
    decision_steps: Tensor
    """(N,) int64: control steps in the decision."""


COLUMNS = (
    "success",
    "terminated",
    "done",
    "human_collision",
    "other_collision",
    "steps",
    "decision_steps",
)
"""What a `Transition` takes from the environment as it is, but for its last dimension."""


class Steps(Protocol):
    """What a training asks of what it steps, in its own process or another."""

    shape: Shape

    def reset(self, precision_m: float) -> Tensor:
        """Begin episodes at this precision in every row; return the observation (N, D)."""

    def start(self, action: Tensor, precision_m: float) -> None:
        """Let a decision (N, A) in [-1, 1] begin; episodes that begin after it are at this precision."""

    def finish(self) -> Transition:
        """Wait for the decision begun; return what it led to."""

    def state_dict(self) -> dict[str, Any]:
        """Return everything a bit-for-bit continuation needs, between two decisions."""

    def load_state_dict(self, state: dict[str, Any]) -> Tensor:
        """Continue from `state_dict`; return the observation (N, D)."""

    def close(self) -> None:
        """Let go of what is held."""


class Collector:
    """Steps an environment in this process, when what a decision led to is asked for.

    Raises:
        ConfigError: the configuration names a guide or a successor, and there is none.
    """

    def __init__(
        self,
        config: AgentConfig,
        env: EnvBase,
        demonstrator: Demonstrator | None = None,
        next_skill: NextSkillValue | None = None,
    ) -> None:
        for what, given in (("demonstrator", demonstrator), ("next_skill", next_skill)):
            if (named := getattr(config, what)) is not None and given is None:
                raise ConfigError(f"agent.{what}={named}: this environment knows no {what}")
        self._config, self._env, self._demonstrator, self._next_skill = config, env, demonstrator, next_skill
        observation = env.observation_spec["observation"]
        rows, names = env.batch_size[0], env.reward_names
        self.shape = Shape(rows, observation.shape[-1], env.action_spec.shape[-1], tuple(names))
        self._now: TensorDictBase = TensorDict()
        self._begun: tuple[Tensor, float] | None = None

    def reset(self, precision_m: float) -> Tensor:
        """See `Collector`."""
        self._env.set_precision(precision_m)
        self._now = self._env.reset()
        return self._now["observation"]

    def start(self, action: Tensor, precision_m: float) -> None:
        """See `Collector`."""
        self._begun = action, precision_m

    def finish(self) -> Transition:
        """See `Collector`."""
        assert self._begun is not None
        (action, precision_m), self._begun = self._begun, None
        self._env.set_precision(precision_m)
        if self._demonstrator is not None:
            shown = self._demonstrator()
            action = torch.cat([shown.to(action.dtype), action[len(shown) :]])
        stepped, self._now = self._env.step_and_maybe_reset(self._now.set("action", action))
        after = stepped["next"]
        columns = {name: after[name][:, 0] for name in COLUMNS}
        reward = after["reward"][:, 0]
        terminal_value = torch.zeros_like(reward)
        if self._next_skill is not None:
            terminal_value = self._config.gamma ** columns["decision_steps"] * self._next_skill(columns["success"])
        return Transition(
            action=action,
            reward=reward,
            terminal_value=terminal_value,
            next_observation=after["observation"],
            observation=self._now["observation"],
            reward_terms=after["reward_terms"],
            **columns,
        )

    def state_dict(self) -> dict[str, Any]:
        """See `Collector`."""
        return {"env": self._env.state_dict(), "now": dict(self._now.items())}

    def load_state_dict(self, state: dict[str, Any]) -> Tensor:
        """See `Collector`."""
        self._env.load_state_dict(state["env"])
        self._now = TensorDict(state["now"], batch_size=self._env.batch_size)
        return self._now["observation"]

    def close(self) -> None:
        """See `Collector`; nothing is held."""
