"""Collector of the training of a skill, optionally with a demonstrator in some environments."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from hrl_comfort.agents.memory import check_replay
from hrl_comfort.config import AgentConfig, ConfigError, TrainConfig
from hrl_comfort.envs.torchrl import CellEnv
from hrl_comfort.files.run_config import environment
from hrl_comfort.policies.load import make_policy
from hrl_comfort.policies.remembering import Remembering
from hrl_comfort.training.logger import OUTCOMES
from hrl_comfort.training.loop import Collected, EpisodeEnd
from hrl_comfort.training.next_skill import NextSkill, NextSkillValue
from hrl_comfort.training.other_levels import OtherLevels
from hrl_comfort.training.t_star import TerminalStates

Demonstrator = Callable[[Tensor], Tensor]
"""Indices of environments (D,) -> actions (D, A) in [-1, 1] for them."""


class SkillCollector:
    """Steps a batched environment one decision at a time.

    Args:
        config: names the demonstrator and the next skill, and holds gamma.
        env: TorchRL environment of N rows that reports `OUTCOMES`, but the return, and `decision_steps` as (N, 1), and
            `reward_terms` (N, T).
        demonstrator: acts in the first environments, once it has taken over there.
        next_skill: values of successes, which are added to the rewards, or terminal states that transitions keep.
        seed: of the decisions at which the demonstrator takes over.
        levels: relabels part of the transitions with other levels.

    Raises:
        ConfigError: the configuration names a demonstrator, a next skill or other levels, and there are none, or the
            replay buffer with terminal states is larger than this machine's memory.
    """

    def __init__(
        self,
        config: AgentConfig,
        env: EnvBase,
        demonstrator: Demonstrator | None = None,
        next_skill: NextSkillValue | TerminalStates | None = None,
        seed: int = 0,
        levels: OtherLevels | None = None,
    ) -> None:
        given = {"demonstrator": demonstrator, "next_skill": next_skill, "other_level": levels}
        for what, part in given.items():
            if (named := getattr(config, what)) and part is None:
                raise ConfigError(f"agent.{what}={named}: this environment knows no {what}")
        self._config, self._env, self._demonstrator, self._next_skill = config, env, demonstrator, next_skill
        self._discriminator = next_skill.discriminator if isinstance(next_skill, TerminalStates) else None
        self._levels = levels
        self.num_envs = env.batch_size[0]
        self.observation_dim = env.observation_spec["observation"].shape[-1]
        self.layout: Mapping[str, range] = getattr(env, "layout", {})
        """Columns of the observation by the name of a part; empty where the environment names none."""
        self.action_dim = env.action_spec.shape[-1]
        if self._discriminator is not None:
            check_replay(config, self.observation_dim, self.action_dim, self._discriminator.starts.shape[1])
        self.reward_names = tuple(env.reward_names)
        self._for_demonstrator = torch.arange(self.num_envs) < config.demonstrator_envs
        self._takeovers = torch.Generator().manual_seed(seed)
        self.demonstrated = torch.zeros(self.num_envs, dtype=torch.bool)
        """(N,) bool: the environments in which the demonstrator acted in the latest decision, and has not ended."""
        self.precision_m = 0.0
        """Precision of the episodes that begin from now on, m."""
        self.reach: float | None = None
        """Part of the way to home at which they begin; None: as the task says."""
        self.now: TensorDictBase = TensorDict()

    def reset(self, precision_m: float, reach: float | None = None) -> None:
        """Begin an episode at this precision and reach in every environment."""
        self.precision_m, self.reach = precision_m, reach
        self._set_difficulty()
        self.now = self._env.reset()
        self._precision = torch.full((self.num_envs,), precision_m, dtype=torch.float64)
        self._returns = torch.zeros(self.num_envs, dtype=torch.float64)
        self._terms = torch.zeros(self.num_envs, len(self.reward_names), dtype=torch.float64)

    def _set_difficulty(self) -> None:
        self._env.set_precision(self.precision_m)
        if self.reach is not None:
            self._env.set_reach(self.reach)

    def step(self, action: Tensor) -> Collected:
        """Take actions (N, A) in [-1, 1]; an outcome's `precision_m` is that of its episode."""
        self._set_difficulty()
        action = self._with_demonstrations(action)
        before = self.now["observation"]
        stepped, self.now = self._env.step_and_maybe_reset(self.now.set("action", action))
        after = stepped["next"]
        reward, success, kept = after["reward"], after["success"][:, 0], dict[str, Tensor]()
        if isinstance(self._next_skill, TerminalStates):
            kept = {"success": success, "terminal_state": self._next_skill.take(success)}
        elif self._next_skill is not None:
            value = self._next_skill(success)
            reward = reward + (self._config.gamma ** after["decision_steps"][:, 0] * value)[:, None]
        transitions = {
            "observation": before,
            "action": action,
            "steps_to_next_obs": after["decision_steps"],
            "demonstrated": self.demonstrated.clone(),
            "next": {
                "observation": after["observation"],
                "reward": reward.float(),
                **{name: after[name] for name in ("terminated", "done")},
                **kept,
            },
        }
        collected = TensorDict(transitions, batch_size=[self.num_envs])
        if self._levels is not None:
            self._levels.relabel(collected, after["reward_terms"])
        self.demonstrated &= ~after["done"][:, 0]
        return Collected(collected, self._end_episodes(after))

    def _with_demonstrations(self, action: Tensor) -> Tensor:
        """Return actions (N, A) with the demonstrator's where it acts, or takes over now."""
        if self._demonstrator is None:
            return action
        now = torch.rand(self.num_envs, generator=self._takeovers) < self._config.demonstrator_takeover
        self.demonstrated |= now & self._for_demonstrator
        rows = self.demonstrated.nonzero()[:, 0]
        if not len(rows):
            return action
        return action.index_copy(0, rows, self._demonstrator(rows).to(action.dtype))

    def _end_episodes(self, after: TensorDictBase) -> list[EpisodeEnd]:
        """Return the outcomes of the episodes that a step ended, but those of the demonstrator's environments."""
        self._returns += after["reward"][:, 0].double()
        self._terms += after["reward_terms"].double()
        rows = after["done"][:, 0].nonzero()[:, 0]
        finished = []
        for row in rows[~self._for_demonstrator[rows]].tolist():
            outcome = {name: float(after[name][row, 0]) for name in OUTCOMES if name != "return"}
            terms = zip(self.reward_names, self._terms[row].tolist(), strict=True)
            outcome |= {"return": float(self._returns[row]), **{f"reward/{name}": value for name, value in terms}}
            finished.append({**outcome, "precision_m": float(self._precision[row])})
        self._returns[rows] = 0.0
        self._terms[rows] = 0.0
        self._precision[rows] = self.precision_m  # what their next episodes have just started with
        return finished

    @property
    def terminal_value(self) -> Callable[[TensorDictBase], Tensor] | None:
        """Value (B,) of raw transitions (B,) that learners add to the rewards of those that they sample."""
        return self._next_skill.value if isinstance(self._next_skill, TerminalStates) else None

    def close(self) -> None:
        """Stop what simulates the environments."""
        self._env.close()

    def state_dict(self) -> dict[str, Any]:
        """Return everything that a bit-for-bit continuation needs."""
        return {
            "env": self._env.state_dict(),
            "now": dict(self.now.items()),
            "precision_m": self.precision_m,
            "reach": self.reach,
            "demonstrated": self.demonstrated.clone(),
            "takeovers": self._takeovers.get_state(),
            "discriminator": self._discriminator.state_dict() if self._discriminator else {},
            "levels": None if self._levels is None else self._levels.generator.get_state(),
            "episodes": {"precision": self._precision, "returns": self._returns, "terms": self._terms},
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self._env.load_state_dict(state["env"])
        self.now = TensorDict(state["now"], batch_size=self._env.batch_size)
        self.precision_m, episodes = state["precision_m"], state["episodes"]
        self.reach, self.demonstrated = state["reach"], state["demonstrated"].clone()
        self._takeovers.set_state(state["takeovers"])
        if self._discriminator is not None:
            self._discriminator.load_state_dict(state["discriminator"])
        if self._levels is not None:
            self._levels.generator.set_state(state["levels"])
        self._precision, self._returns, self._terms = episodes["precision"], episodes["returns"], episodes["terms"]


def make_collector(config: TrainConfig) -> SkillCollector:
    """Return a collector over the batched workcells of `config`.

    Raises:
        ConfigError: a choice is not allowed, or the demonstrator or the next skill does not fit the task.
    """
    agent, discriminator = config.agent, None
    skill = None if agent.next_skill is None else NextSkill(config)
    if skill is not None and agent.next_skill_reward:  # first: two environments could not read the same live stream
        discriminator = skill.discriminator(agent.next_skill_reward, config.train_seed)
    env = CellEnv(environment(config), config.engine.num_envs, config.episode_seed)
    demonstrator = None if agent.demonstrator is None else make_demonstrator(config, env)
    next_skill: NextSkillValue | TerminalStates | None = None
    if skill is not None:
        next_skill = skill.value(env) if discriminator is None else skill.terminal_states(env, discriminator)
    levels = OtherLevels(config, env) if agent.other_level else None
    return SkillCollector(agent, env, demonstrator, next_skill, config.train_seed, levels)


def make_demonstrator(config: TrainConfig, env: CellEnv) -> Demonstrator:
    """Return the policy `agent.demonstrator` for environments of `env`.

    Raises:
        ConfigError: there is no such policy, or it does not fit this training.
    """
    source, episodes = config.agent.demonstrator, env.engine.episodes
    assert source is not None
    if source == "random":
        raise ConfigError(
            "agent.demonstrator=random demonstrates nothing; choose expert, potential_field or a trained policy"
        )
    try:
        act = make_policy(source, episodes.subtask, env.engine.scene, environment(config), config.train_seed)
    except ConfigError as error:
        raise ConfigError(f"agent.demonstrator={source}: {error}") from error
    if isinstance(act, Remembering):
        raise ConfigError(f"agent.demonstrator={source} remembers, and checkpoints do not keep that; choose another")

    def demonstrator(rows: Tensor) -> Tensor:
        assert episodes.state is not None
        return act(episodes.observed(episodes.state).rows(rows))

    return demonstrator
