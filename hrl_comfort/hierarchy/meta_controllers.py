"""What a controller of `sort` may choose by: pure functions of state, mask and how long it has waited.

Options are those of `sorting_options`: for each level a skill may be told, the one in force first, a pick for
each of B balls, place and return; then wait and retreat.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from hrl_comfort.comfort.metrics import human_distance
from hrl_comfort.config import ConfigError
from hrl_comfort.tasks import State

WAIT, RETREAT = -2, -1
"""Where these options stand in the list, from its end."""
NEAR_M = 0.55
"""`cautious` waits while the person is within this of where the tool has to go next, m."""
PATIENCE = 6
"""Waits in a row after which `cautious` goes on."""


@dataclass(frozen=True)
class Decision:
    """What a controller knows when an option of some of N rows has ended."""

    state: State
    mask: Tensor
    """(N, K) bool, the options that can start."""
    waits: Tensor
    """(N,) int64, waits in a row until now."""


Choose = Callable[[Decision], Tensor]
"""A decision -> the option (N,) int64 that begins, in the rows that decide."""


def next_of(decision: Decision, score: Tensor) -> Tensor:
    """Return the option (N,) that takes the task on; of the picks that can start, the one of highest score.

    Where none of these can start, an option was preempted, and the arm retreats. `score` is (N, B), one for
    each ball.
    """
    balls, count = score.shape[1], decision.mask.shape[1]
    best = torch.where(decision.mask[:, :balls], score, -torch.inf).argmax(dim=1)
    best = torch.where(decision.mask[:, :balls].any(dim=1), best, count + RETREAT)
    place, back = decision.mask[:, balls], decision.mask[:, balls + 1]
    return torch.where(place, balls, torch.where(back, balls + 1, best))


def nearest(decision: Decision) -> Tensor:
    """Choose the nearest ball first."""
    state = decision.state
    return next_of(decision, -(state.balls - state.tcp_pos[:, None]).norm(dim=-1))


def cautious(decision: Decision) -> Tensor:
    """Choose the ball whose way is farthest from the person; wait, a while, where they stand at the goal."""
    state = decision.state
    person = state.human_pos[:, None]
    score = torch.minimum(human_distance(state.balls, person), human_distance(state.drops, person))
    chosen = next_of(decision, score)
    balls, count = score.shape[1], decision.mask.shape[1]
    ball = chosen.clamp(max=balls - 1)
    goal = torch.where((chosen < balls)[:, None], state.balls[torch.arange(len(ball)), ball], state.drop_pos)
    near = human_distance(goal, state.human_pos) < NEAR_M
    waits = near & (decision.waits < PATIENCE) & (chosen <= balls)
    return torch.where(waits, count + WAIT, chosen)


def at_random(seed: int) -> Choose:
    """Choose any option that can start, each as likely."""
    generator = torch.Generator().manual_seed(seed)

    def choose(decision: Decision) -> Tensor:
        return torch.multinomial(decision.mask.double(), 1, generator=generator).squeeze(1)

    return choose


def make_choice(name: str, seed: int) -> Choose:
    """Return how the controller `name` chooses.

    Raises:
      ConfigError: there is no such controller.
    """
    known: dict[str, Choose] = {"scripted": nearest, "cautious": cautious, "random": at_random(seed)}
    if name not in known:
        raise ConfigError(f"meta_controller={name} does not sort; choose one of {', '.join(known)} or learned")
    return known[name]
