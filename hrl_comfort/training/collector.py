"""Collectors step environments for the trainer, optionally with a demonstrator in some of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from hrl_comfort.config import AgentConfig, ConfigError, TrainConfig
from hrl_comfort.config.compose import environment
from hrl_comfort.envs.torchrl import CellEnv
from hrl_comfort.policies.actor import load_policy
from hrl_comfort.policies.load import make_policy, observed_by
from hrl_comfort.tasks import subtask

Demonstrator = Callable[[], Tensor]
"""() -> actions (demonstrator_envs, A) in [-1, 1] for the first environments."""
NextSkillValue = Callable[[Tensor], Tensor]
"""success (N,) bool of the latest decision -> its value (N,) to the next skill, 0 without success."""


@dataclass(frozen=True)
class Transition:
    """Result of one decision in each of N environments."""

    action: Tensor
    """(N, A): the action taken, the demonstrator's in its environments."""
    reward: Tensor
    """(N,)."""
    terminal_value: Tensor
    """(N,): value of a success to the next skill, discounted; added to the reward."""
    next_observation: Tensor
    """(N, D): before an environment is reset."""
    observation: Tensor
    """(N, D): the observation of the next decision."""
    reward_terms: Tensor
    """(N, T)."""
    success: Tensor
    """(N,) bool, as are the next five."""
    terminated: Tensor
    done: Tensor
    contact: Tensor
    unsafe_contact: Tensor
    other_collision: Tensor
    steps: Tensor
    """(N,) int64: control steps in the episode."""
    decision_steps: Tensor
    """(N,) int64: control steps in the decision."""
    shield_share_mean: Tensor
    """(N,): part of the speed asked for that the shield passed in the episode so far; 1 without a shield."""
    protective_stops: Tensor
    """(N,) int64: in the episode so far."""


COLUMNS = (
    *("success", "terminated", "done", "contact", "unsafe_contact", "other_collision", "steps", "decision_steps"),
    *("shield_share_mean", "protective_stops"),
)
"""Fields of `Transition` that the environment reports as (N, 1)."""


class Collector:
    """Steps a batched environment one decision at a time.

    Args:
        config: names the demonstrator and the next skill, and holds gamma.
        env: TorchRL environment of N rows that reports `COLUMNS` and `reward_terms`.
        demonstrator: acts in the first environments.
        next_skill: values of successes.

    Raises:
        ConfigError: the configuration names a demonstrator or a next skill, and there is none.
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
        self.num_envs = env.batch_size[0]
        self.observation_dim = env.observation_spec["observation"].shape[-1]
        self.action_dim = env.action_spec.shape[-1]
        self.reward_names = tuple(env.reward_names)
        self._now: TensorDictBase = TensorDict()

    def reset(self, precision_m: float) -> Tensor:
        """Begin an episode at this precision in every environment; return the observation (N, D)."""
        self._env.set_precision(precision_m)
        self._now = self._env.reset()
        return self._now["observation"]

    def step(self, action: Tensor, precision_m: float) -> Transition:
        """Take actions (N, A) in [-1, 1]; episodes that begin after them are at this precision."""
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
        """Return everything that a bit-for-bit continuation needs."""
        return {"env": self._env.state_dict(), "now": dict(self._now.items())}

    def load_state_dict(self, state: dict[str, Any]) -> Tensor:
        """Continue from `state_dict`; return the observation (N, D)."""
        self._env.load_state_dict(state["env"])
        self._now = TensorDict(state["now"], batch_size=self._env.batch_size)
        return self._now["observation"]


def make_collector(config: TrainConfig) -> Collector:
    """Return a collector over the batched workcells of `config`.

    Raises:
        ConfigError: a choice is not allowed, or the demonstrator or the next skill does not fit the task.
    """
    env = CellEnv(environment(config), config.engine.num_envs, config.episode_seed)
    demonstrator = None if config.agent.demonstrator is None else make_demonstrator(config, env)
    next_skill = None if config.agent.next_skill is None else make_next_skill_value(config, env)
    return Collector(config.agent, env, demonstrator, next_skill)


def make_demonstrator(config: TrainConfig, env: CellEnv) -> Demonstrator:
    """Return the policy `agent.demonstrator` for the first environments of `env`.

    Raises:
        ConfigError: there is no such policy, or it does not fit this training.
    """
    source, episodes = config.agent.demonstrator, env.engine.episodes
    rows = torch.arange(config.agent.demonstrator_envs)
    assert source is not None
    if source == "random":
        raise ConfigError(
            "agent.demonstrator=random demonstrates nothing; choose expert, potential_field or a trained policy"
        )
    try:
        act = make_policy(source, episodes.subtask, env.engine.scene, environment(config), config.train_seed)
    except ConfigError as error:
        raise ConfigError(f"agent.demonstrator={source}: {error}") from error

    def demonstrator() -> Tensor:
        assert episodes.state is not None
        return act(episodes.observed(episodes.state).rows(rows))

    return demonstrator


def make_next_skill_value(config: TrainConfig, env: CellEnv) -> NextSkillValue:
    """Return the value of the states that `env` ends in to the policy `agent.next_skill`.

    The target of a success then bootstraps on that policy's critics, as one policy's would in the longer task, if
    both were trained with the same gamma and rewards, which is not checked.

    Raises:
        ConfigError: there is no such policy, it starts elsewhere, or it does not fit this training.
    """
    source = Path(config.agent.next_skill or "")
    try:
        policy = load_policy(source, critics=True)
        spec = policy.spec
        task = subtask(spec["task"], spec["environment"]["observation"], config.task.balls)
        seen = observed_by(policy, str(source), task, environment(config))
    except ConfigError as error:
        raise ConfigError(f"agent.next_skill={source}: {error}") from error
    own = subtask(config.task.name, config.task.observation, config.task.balls)
    if task.start != own.stages[-1].next_start:
        raise ConfigError(f"agent.next_skill={source}: {task.name} does not begin where {own.name} ends")

    def next_skill(success: Tensor) -> Tensor:
        values = torch.zeros(len(success))
        rows = success.nonzero()[:, 0]
        if len(rows):
            assert env.last is not None
            state = env.last.state.rows(rows)
            values[rows] = policy.value(seen.observe(state.with_(stage=torch.zeros_like(state.stage))).float())
        return values

    return next_skill
