"""HIRO (Nachum et al. 2018, arXiv:1805.08296): an upper policy sets goals, a lower one pursues them.

Both are soft actor-critics. A goal is a change of some columns of the observation; after every decision it becomes what
is left of it. The lower policy is rewarded for the closeness to it. The upper policy learns from what several decisions
earn, after each past goal is replaced by the one that makes the actions which followed it most likely.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn

from hrl_comfort.agents.baselines.turns import seldom
from hrl_comfort.agents.memory import check_memory
from hrl_comfort.agents.sac import SAC
from hrl_comfort.config import AgentConfig, ConfigError
from hrl_comfort.config.learning import HIROKeys

SPREAD = 0.5
"""Standard deviation of the candidates around the change that happened, as a share of the farthest goal."""


class Goals:
    """Goals in some columns of an observation, in parts of the farthest one."""

    def __init__(self, columns: list[int], reach: float) -> None:
        self.columns, self.reach = columns, reach

    def change(self, before: Tensor, after: Tensor) -> Tensor:
        """Return the goal (…, G) that leads from observations (…, D) to others exactly."""
        return (after[..., self.columns] - before[..., self.columns]) / self.reach

    def left(self, goal: Tensor, before: Tensor, after: Tensor) -> Tensor:
        """Return what is left (…, G) of a goal that was set before (eq. 1)."""
        return goal - self.change(before, after)


class GoalPolicy(nn.Module):
    """The two actors as one policy: its memory is the decisions left, the goal and where that was set."""

    def __init__(self, upper: SAC, lower: SAC, goals: Goals, every: int) -> None:
        super().__init__()
        self.upper, self.upper_sight = upper.average, upper.normaliser
        self.lower, self.lower_sight = lower.average, lower.normaliser
        self._goals, self._every, self._size = goals, every, upper.action_dim
        self.memory_dim = 1 + self._size + upper.observation_dim

    def forward(self, observation: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return actions (N, A) and what to remember (N, M), for raw observations (N, D) and what was remembered."""
        left, goal, before = memory.split([1, self._size, observation.shape[1]], dim=1)
        new = self.upper.mode(self.upper_sight(observation))
        goal = torch.where(left < 0.5, new, self._goals.left(goal, before, observation))
        left = torch.where(left < 0.5, self._every, left) - 1
        action = self.lower.mode(self.lower_sight(torch.cat([observation, goal], dim=1)))
        return action, torch.cat([left, goal, observation], dim=1)


class Upper(SAC):
    """The learner of the goals, whose batches have past goals replaced."""

    lower: SAC
    goals: Goals
    candidates: int

    def sample(self) -> TensorDict:
        """Return B transitions as of any soft actor-critic, with the likeliest goals as actions, or those shown."""
        batch = super().sample()
        batch["action"] = torch.where(batch["demonstrated"][:, None], batch["action"], self.likeliest(batch))
        return batch

    @torch.no_grad()
    def likeliest(self, batch: TensorDictBase) -> Tensor:
        """Return the goals (B, G) of greatest likelihood among those set, those that came true, and some beside.

        `batch` holds `action` (B, G); of the decisions that followed `seen` (B, c, D), `acted` (B, c, A) and how many
        they are, `count` (B, 1); and `change` (B, G).
        """
        size = len(batch), self.candidates - 2, self.action_dim
        around = SPREAD * torch.randn(size, generator=self.generator).to(self.device)
        happened = batch["change"][:, None]
        found = torch.cat([batch["action"][:, None], happened, happened + around], dim=1).clamp(-1.0, 1.0)
        best = self.log_likelihood(batch, found).argmax(dim=1)
        return found[torch.arange(len(found)), best]

    def log_likelihood(self, batch: TensorDictBase, goals: Tensor) -> Tensor:
        """Return (B, C), but for a constant, of the actions under each of the goals (B, C, G) (eq. 5)."""
        seen, count = batch["seen"][:, None], goals.shape[1]
        then = self.goals.left(goals[:, :, None], seen[:, :, :1], seen)
        given = torch.cat([seen.expand(-1, count, -1, -1), then], dim=-1)
        wanted = self.lower.actor.mode(self.lower.normaliser(given))
        off = (batch["acted"][:, None] - wanted).square().sum(-1)
        happened = torch.arange(seen.shape[2], device=off.device) < batch["count"]
        return -0.5 * (off * happened[:, None]).sum(-1)


class HIRO:
    """The learner: `lower` learns from every decision, `upper` from every goal.

    What a demonstrator reaches in the time of a goal is taken for the goal that it pursued.

    Raises:
        ConfigError: a column is not one of the observation, or as soft actor-critic.
    """

    Keys = HIROKeys
    columns = ("goals",)
    """Own keys that are columns of the observation, here by number."""

    def __init__(self, config: AgentConfig, observation_dim: int, action_dim: int, own: HIROKeys) -> None:
        columns = [*map(int, own.goals)] or list(range(observation_dim))
        if max(columns) >= observation_dim:
            raise ConfigError(f"agent.own.goals={columns}: the observation has columns 0 to {observation_dim - 1}")
        self.config, self.own, self.goals = config, own, Goals(columns, own.reach)
        self.observation_dim, self.action_dim = observation_dim, action_dim
        check_memory(f"agent.buffer_size={config.buffer_size}", config.buffer_size * (observation_dim + action_dim))
        none = replace(config, name="sac", own={})
        self.lower = SAC(none, observation_dim + len(columns), action_dim)
        self.upper = Upper(self._upper_config(none), observation_dim, len(columns))
        self.upper.lower, self.upper.goals, self.upper.candidates = self.lower, self.goals, own.candidates
        self.policy = GoalPolicy(self.upper, self.lower, self.goals, own.every)
        self.terms = (*self.lower.terms, *(f"upper_{name}" for name in self.upper.terms))
        self._upper_terms: dict[str, float] = {}
        self._forget(0)

    def _upper_config(self, config: AgentConfig) -> AgentConfig:
        return replace(seldom(config, self.own.every), target_entropy=-float(len(self.goals.columns)))

    def _forget(self, rows: int) -> None:
        """Let episodes begin in N environments."""
        every, sizes = self.own.every, (self.observation_dim, self.action_dim)
        self._goal = torch.zeros(rows, len(self.goals.columns))
        """(N, G) in force."""
        self._count = torch.zeros(rows, dtype=torch.int64)
        """(N,) decisions since the latest goal was set; the fields below are of these."""
        self._shown = torch.zeros(rows, every, dtype=torch.bool)
        self._lasted = torch.zeros(rows, every, 1, dtype=torch.int64)
        self._set = torch.zeros_like(self._goal)
        self._seen, self._acted = (torch.zeros(rows, every, size) for size in sizes)
        self._earned, self._steps = torch.zeros(rows, 1), torch.zeros(rows, 1, dtype=torch.int64)

    @torch.no_grad()
    def act(self, now: TensorDictBase, exploration: float = 0.0) -> Tensor:
        """Return actions (N, A), towards goals that are set anew where their time is up or an episode begins."""
        observation = now["observation"]
        if len(self._count) != len(observation):
            self._forget(len(observation))
        begins = (self._count == 0).nonzero()[:, 0]
        if len(begins):
            goal = self.upper.act(TensorDict({"observation": observation[begins]}), exploration)
            self._goal, self._set = (each.index_copy(0, begins, goal) for each in (self._goal, self._set))
        return self.lower.act(TensorDict({"observation": torch.cat([observation, self._goal], dim=1)}), exploration)

    def observe(self, transitions: TensorDictBase) -> None:
        """Store transitions (N,), one of each environment, for the lower policy, and goals that are over for the upper.

        What a goal earned is discounted from the time when it was set. To the lower policy no episode terminates.
        """
        before, then, shown = transitions["observation"], transitions["next"], transitions["demonstrated"]
        left, after = self.goals.left(self._goal, before, then["observation"]), then["observation"]
        if bool((own := ~shown).any()):
            goals, lasted = (self._goal[own], left[own]), transitions["steps_to_next_obs"][own]
            self._learn_lower(before[own], after[own], *goals, transitions["action"][own], lasted, shown[own])
        rows = torch.arange(len(before))
        self._seen[rows, self._count] = before
        self._acted[rows, self._count] = transitions["action"].float()
        self._shown[rows, self._count] = shown
        self._lasted[rows, self._count] = transitions["steps_to_next_obs"]
        self._earned += self.config.gamma**self._steps * then["reward"]
        self._steps += transitions["steps_to_next_obs"]
        self._count += 1
        self._goal = left
        over = (self._count == self.own.every) | then["done"][:, 0]
        if bool(over.any()):
            self._learn_from_shown(after, over)
            self._store(then, over)

    def _learn_lower(
        self, before: Tensor, after: Tensor, goal: Tensor, left: Tensor, action: Tensor, lasted: Tensor, shown: Tensor
    ) -> None:
        """Store decisions (F,) for the lower policy, which were to reach a `goal` (F, G), of which this is `left`."""
        then = {
            "observation": torch.cat([after, left], dim=1),
            "reward": -left.norm(dim=1, keepdim=True),
            # An end would be worth 0, more than any way to a goal, and the policy would learn to crash.
            "terminated": torch.zeros(len(before), 1, dtype=torch.bool),
        }
        seen = {"observation": torch.cat([before, goal], dim=1), "action": action, "steps_to_next_obs": lasted}
        self.lower.observe(TensorDict({**seen, "demonstrated": shown, "next": then}, batch_size=[len(before)]))

    def _learn_from_shown(self, last: Tensor, over: Tensor) -> None:
        """Store what was demonstrated in the rows `over` (N,) bool, which see `last` (N, D), as ways to its ends."""
        rows, at = torch.nonzero(self._shown & over[:, None], as_tuple=True)
        if not len(rows):
            return
        following = torch.cat([self._seen[:, 1:], last[:, None]], dim=1)
        ends = at + 1 == self._count[rows]
        before, end = self._seen[rows, at], last[rows]
        after = torch.where(ends[:, None], end, following[rows, at])
        ways = self.goals.change(before, end), self.goals.change(after, end)
        self._learn_lower(before, after, *ways, self._acted[rows, at], self._lasted[rows, at], self._shown[rows, at])

    def _store(self, then: TensorDictBase, over: Tensor) -> None:
        """Store the goals of the rows `over` (N,) bool, after whose latest decision things are as `then` says."""
        after = {"observation": then["observation"], "reward": self._earned, "terminated": then["terminated"]}
        happened = torch.arange(self.own.every) < self._count[:, None]
        shown, change = (self._shown | ~happened).all(dim=1), self.goals.change(self._seen[:, 0], then["observation"])
        goals = {
            "observation": self._seen[:, 0],
            "action": torch.where(shown[:, None], change.clamp(-1.0, 1.0), self._set),
            "steps_to_next_obs": self._steps,
            "demonstrated": shown,
            "next": after,
            "seen": self._seen,
            "acted": self._acted,
            "count": self._count[:, None],
            "change": change,
        }
        self.upper.observe(TensorDict(goals, batch_size=[len(over)])[over])
        self._count, self._shown = self._count.masked_fill(over, 0), self._shown & ~over[:, None]
        self._earned, self._steps = (each.masked_fill(over[:, None], 0) for each in (self._earned, self._steps))

    def update(self) -> dict[str, float]:
        """Do an update of the lower policy, and of the upper one where it is due; return their terms."""
        if not len(self.upper.buffer):
            return {}
        if self.lower.updates % self.own.every == 0 or not self._upper_terms:
            self._upper_terms = {f"upper_{name}": value for name, value in self.upper.update().items()}
        return {**self.lower.update(), **self._upper_terms}

    def begin_stage(self, config: AgentConfig, keep_replay: bool, keep_optimiser: bool) -> None:
        """Go on under `config`, of the same sizes, in episodes that begin."""
        self.config, none = config, replace(config, name="sac", own={})
        self.lower.begin_stage(none, keep_replay, keep_optimiser)
        self.upper.begin_stage(self._upper_config(none), keep_replay, keep_optimiser)
        self._forget(0)

    _GOING_ON = (
        "_goal", "_count", "_set", "_seen", "_acted", "_shown", "_lasted", "_earned", "_steps", "_upper_terms",
    )  # fmt: skip

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to continue, as plain data."""
        going_on = {name: getattr(self, name) for name in self._GOING_ON}
        return {"upper": self.upper.state_dict(), "lower": self.lower.state_dict(), **going_on}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`, in a learner that has stored nothing yet."""
        for name in ("upper", "lower"):
            getattr(self, name).load_state_dict(state[name])
        for name in self._GOING_ON:
            setattr(self, name, state[name])
