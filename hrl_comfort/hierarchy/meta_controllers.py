"""Meta-controllers: pure functions that choose the next option from a `Decision`.

Those of `sort` rely on the order of `sorting_options`: for each level a skill may be given, the one in force
first, a pick for each of B objects, place and return; then wait and retreat.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from hrl_comfort.comfort.terms import human_distance
from hrl_comfort.config.checks import implemented
from hrl_comfort.config.hierarchy import SORTERS
from hrl_comfort.hierarchy.executor import Choose, Decision

WAIT, RETREAT = -2, -1
"""Positions of these options, from the end of the list."""
NEAR_M = 0.55
"""`cautious` waits while the person is within this distance of the tool's next goal, m."""


def in_order(decision: Decision) -> Tensor:
    """Choose the first option that can start: in a chain, the one whose stage is in force."""
    return decision.mask.int().argmax(dim=1)


def next_option(decision: Decision, score: Tensor) -> Tensor:
    """Return the option (N,) that advances the task; of the picks that can start, the one of highest score.

    Where none of these can start, an option was preempted, and the arm retreats. `score` is (N, B), one for
    each object.
    """
    objects, count = score.shape[1], decision.mask.shape[1]
    best = torch.where(decision.mask[:, :objects], score, -torch.inf).argmax(dim=1)
    best = torch.where(decision.mask[:, :objects].any(dim=1), best, count + RETREAT)
    place, back = decision.mask[:, objects], decision.mask[:, objects + 1]
    return torch.where(place, objects, torch.where(back, objects + 1, best))


def nearest(decision: Decision) -> Tensor:
    """Choose the object nearest to the tool."""
    state = decision.state
    return next_option(decision, -(state.objects - state.tcp_pos[:, None]).norm(dim=-1))


def cautious(decision: Decision) -> Tensor:
    """Choose the object farthest from people, and wait, where that is allowed, for a person near the goal."""
    state = decision.state
    people = state.humans_pos[:, None]
    score = torch.minimum(human_distance(state.objects, people), human_distance(state.object_places, people))
    chosen = next_option(decision, score)
    objects, count = score.shape[1], decision.mask.shape[1]
    index = chosen.clamp(max=objects - 1)
    picked = state.objects[torch.arange(len(index)), index]
    goal = torch.where((chosen < objects)[:, None], picked, state.target_place)
    near = human_distance(goal, state.humans_pos) < NEAR_M
    waits = near & decision.mask[:, WAIT] & (chosen <= objects)
    return torch.where(waits, count + WAIT, chosen)


def at_random(seed: int) -> Choose:
    """Return a meta-controller that chooses uniformly among the options that can start."""
    generator = torch.Generator().manual_seed(seed)

    def choose(decision: Decision) -> Tensor:
        return torch.multinomial(decision.mask.double(), 1, generator=generator).squeeze(1)

    return choose


def with_level_override(choose: Choose) -> Choose:
    """Return the meta-controller that chooses alike but overrides the level of every skill by the first one it may.

    Without a level that it may give, it is `choose`.
    """

    def chosen(decision: Decision) -> Tensor:
        option, waits = choose(decision), decision.mask.shape[1] + WAIT
        skills = decision.state.objects.shape[1] + 2
        return torch.where(option < waits, option + skills, option) if waits > skills else option

    return chosen


CHOICES: dict[str, Callable[[int], Choose]] = implemented(
    SORTERS,
    {
        "scripted": lambda seed: with_level_override(nearest),
        "cautious": lambda seed: with_level_override(cautious),
        "random": at_random,
    },
)
"""Meta-controllers of `sort` by name, from a seed; `learned` is loaded by `q_learning.load_choice`."""
