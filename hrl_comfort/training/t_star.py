"""Terminal-state regularisation of T-STAR (Lee et al. 2021, arXiv:2111.07999): end where the next skill has begun.

A discriminator learns to tell the states from which the next skill has succeeded from those in which this one ends; a
success earns what it says. Transitions keep what the next skill would observe, and learners ask the discriminator when
they sample them, so that no reward in the replay buffer is older than it. The paper's imitation of demonstrations is
`agent.demonstrator`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from rich.console import Console
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.modules import MLP

from hrl_comfort.config import TERMINAL_STATES_SEED, ConfigError
from hrl_comfort.envs.torchrl import CellEnv
from hrl_comfort.files.run_config import trained_environment

STARTS, CELLS = 256, 64
"""Number of starts that are sought, and of cells in which they are."""
EPISODES = 16
"""Number of the longest episodes in each cell after which the search ends."""
KEPT = 1024
"""Number of the latest terminal states that are kept."""
HIDDEN, LEARNING_RATE, BATCH, UPDATES = 128, 3e-4, 64, 4
"""Of the discriminator; updates for each decision that a success ends."""


class StartDiscriminator:
    """Tells starts of the next skill (S, D), as that observes them, from terminal states of this one, and learns to.

    `weight` is that of the reward. The random numbers, from `seed`, are its own.
    """

    def __init__(self, starts: Tensor, weight: float, seed: int) -> None:
        self.starts, self.weight = starts, weight
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.network = MLP(starts.shape[1], 1, num_cells=[HIDDEN, HIDDEN], activation_class=nn.ReLU)
        self.optimiser = torch.optim.Adam(self.network.parameters(), lr=LEARNING_RATE)
        self.generator = torch.Generator().manual_seed(seed)
        self.ends = starts[:0]

    @torch.no_grad()
    def rewards(self, ends: Tensor) -> Tensor:
        """Return the rewards (F,) of terminal states (F, D), in [0, weight]: larger, the more they look like starts."""
        scores: Tensor = self.network(ends)[:, 0]
        return self.weight * scores.clamp(0.0, 1.0)

    def learn(self, ends: Tensor) -> None:
        """Take in terminal states (F, D) and do some updates."""
        self.ends = torch.cat([self.ends, ends])[-KEPT:]
        for _ in range(UPDATES):
            loss = (self._scores(self.starts) - 1).square().mean() + self._scores(self.ends).square().mean()
            self.optimiser.zero_grad()
            loss.backward()
            self.optimiser.step()

    def _scores(self, states: Tensor) -> Tensor:
        """Return the scores (BATCH,) of some of the states, drawn anew: towards 1 for starts, 0 for terminal states."""
        rows = torch.randint(len(states), (BATCH,), generator=self.generator)
        scores: Tensor = self.network(states[rows])[:, 0]
        return scores

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to continue, as plain data."""
        parts = {name: getattr(self, name).state_dict() for name in ("network", "optimiser")}
        return {**parts, "generator": self.generator.get_state(), "ends": self.ends}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        for name in ("network", "optimiser"):
            getattr(self, name).load_state_dict(state[name])
        self.generator.set_state(state["generator"])
        self.ends = state["ends"]


class TerminalStates:
    """The terminal states of successes: the discriminator learns from them, and says what they earn.

    `observed` gives what the next skill would observe (F, D) in rows (F,) of the environment.
    """

    def __init__(self, discriminator: StartDiscriminator, observed: Callable[[Tensor], Tensor]) -> None:
        self.discriminator, self._observed = discriminator, observed

    def take(self, success: Tensor) -> Tensor:
        """Learn from successes (N,) bool of the latest decision; return their terminal states (N, D), 0 elsewhere."""
        states = torch.zeros(len(success), self.discriminator.starts.shape[1])
        rows = success.nonzero()[:, 0]
        if len(rows):
            states[rows] = self._observed(rows)
            self.discriminator.learn(states[rows])
        return states

    def value(self, transitions: TensorDictBase) -> Tensor:
        """Return the present rewards (B,) of transitions whose `next` holds `success` and `terminal_state`; else 0."""
        success, states = (transitions["next", name] for name in ("success", "terminal_state"))
        values, rows = torch.zeros(len(success), device=states.device), success.nonzero()[:, 0]
        if len(rows):
            values[rows] = self.discriminator.rewards(states[rows].cpu()).to(states.device)
        return values


@torch.no_grad()
def successful_starts(policy: nn.Module, source: str) -> Tensor:
    """Return first observations (S, D) of episodes in which a policy's module succeeds, drawn as in its training.

    `source` is the policy's run folder or file. Where it never succeeds, a line says so, and all episodes count.

    Raises:
      ConfigError: nothing says in which cell it was trained.
    """
    config = trained_environment(source)
    if config is None:
        raise ConfigError(f"agent.next_skill={source} does not say in which cell it was trained; give its run folder")
    env = CellEnv(config, CELLS, TERMINAL_STATES_SEED)
    now = env.reset()
    first, every, found = now["observation"].clone(), list[Tensor](), list[Tensor]()
    for _ in range(EPISODES * config.task.max_episode_steps // config.task.action_repeat):
        stepped, now = env.step_and_maybe_reset(now.set("action", policy(now["observation"])))
        done, success = (stepped["next", name][:, 0] for name in ("done", "success"))
        every.append(first[done])
        found.append(first[done & success])
        first = torch.where(done[:, None], now["observation"], first)
        if sum(map(len, found)) >= STARTS:
            break
    env.close()
    starts = torch.cat(found)[:STARTS]
    if len(starts):
        return starts
    warning = f"agent.next_skill={source} never succeeds in its own training; all its starts count as good"
    Console(stderr=True).print(warning, soft_wrap=True)
    return torch.cat([*every, first])[:STARTS]
