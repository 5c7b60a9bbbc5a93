"""Tops: what chooses the next option, by name, and those of users. A rule is a pure function of a `Decision`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from hrl_comfort.comfort.terms import human_distance
from hrl_comfort.config import SORTING, ConfigError, EvaluateConfig
from hrl_comfort.config.checks import implemented, one_of, part, takes
from hrl_comfort.config.hierarchy import RULES as RULE_NAMES
from hrl_comfort.config.hierarchy import TOPS as NAMES
from hrl_comfort.hierarchy.decision import KEY, VALUE, Choose, Decision, Top
from hrl_comfort.hierarchy.options import NONE, OptionTable
from hrl_comfort.policies.draws import OF_TOPS, uniform

NEAR_M = 0.55
"""`cautious` waits while a person is within this distance of the tool's next goal, m."""
PATIENT_M = 0.9
"""`patient` waits at level 1 while a person is within this distance of an object or of where it belongs, m."""
AWAY_M, FILL_S = 0.7, 4.0
"""`due` leaves orders for later that a person is within this distance of, m; `due` and `greedy` those that are due
sooner, s."""
LATEST_S = 1000.0
"""Time from which on `due` sees no difference in when orders are due."""
SLOW_M, LEAST_SHARE, AHEAD_S = (0.5, 1.5), 0.1, 1.0
"""`greedy` takes the speed that the shield leaves to rise from LEAST_SHARE to 1 between these distances of people, m,
where they will be after AHEAD_S."""
MakeTop = Callable[[EvaluateConfig, OptionTable, int], Choose]
"""(configuration, options, seed) -> top."""


def make_top(config: EvaluateConfig, table: OptionTable, seed: int) -> Top:
    """Return the top that `config` names: one of TOPS, an entry point or `package.module:name`.

    `seed` is for those that choose at random.

    Raises:
      ConfigError: it is not there, or it does not go with the options.
    """
    name = config.meta_controller.name
    if name in TOPS:
        return _top(name, TOPS[name](config, table, seed))
    found: Any = part(KEY, name, TOPS)
    try:
        found = found() if isinstance(found, type) else found
    except TypeError as error:
        raise ConfigError(f"{KEY}={name!r} is a class that cannot be made without arguments: {error}") from error
    return _top(name, found)


def _top(name: str, found: Any) -> Top:
    """Return a callable, or what has `choose`, as a top; `begin`, `values` and `quantity` of it are optional."""
    choose = getattr(found, "choose", found)
    if not callable(choose):
        raise ConfigError(f"{KEY}={name!r} is of type {type(found).__name__}; it must be callable or have choose")
    takes(f"{KEY}={name!r}", choose, "decision")
    if (begin := getattr(found, "begin", None)) is not None:
        takes(f"{KEY}={name!r}: begin", begin, "rows")
    values, quantity = getattr(found, "values", None), getattr(found, "quantity", VALUE)
    told = values if callable(values) else None
    return Top(name, choose, getattr(found, "begin", None), values=told, quantity=quantity)


def in_order(decision: Decision) -> Tensor:
    """Choose the first option that can start: in a chain, the one whose stage is in force."""
    return decision.mask.int().argmax(dim=1)


def advance(decision: Decision, score: Tensor) -> Tensor:
    """Return the choice (N,) that advances the task, at the first level that a skill may be given if there is one.

    Of the objects the one of highest score is picked, `score` (N, B). Where nothing advances the task, the first option
    that can start is chosen: the arm goes home.
    """
    able = decision.mask & preferred(decision.table)
    best = torch.where(able, of_object(decision.table, score), -torch.inf).argmax(dim=1)
    return torch.where(able.any(dim=1), best, in_order(decision))


def preferred(table: OptionTable) -> Tensor:
    """Return (K,) bool: skills at the first level that they may be given or, if there is none, at the one in force."""
    given = ~table.level.isnan()
    return table.advances & (table.level == table.level[given.int().argmax()] if bool(given.any()) else True)


def of_object(table: OptionTable, value: Tensor) -> Tensor:
    """Return (N, K): the value (N, B) of the object of each choice, 0 of those without one."""
    return torch.where(table.object == NONE, 0.0, value[:, table.object.clamp(min=0)])


def clearance(decision: Decision) -> Tensor:
    """Return (N, B) m, the smaller of two distances of each object: of people from it, and from where it belongs."""
    return decision.jobs.gap.flatten(2).amin(dim=2)


def waiting(decision: Decision, chosen: Tensor, waits: Tensor) -> Tensor:
    """Return the choices (N,), `wait` in the rows that `waits` (N,) says and where it can start."""
    wait = decision.table.position("wait")
    return torch.where(waits & decision.mask[:, wait], wait, chosen)


def nearest(decision: Decision) -> Tensor:
    """Choose the object nearest to the tool."""
    state = decision.state
    return advance(decision, -(state.objects - state.tcp_pos[:, None]).norm(dim=-1))


def free(decision: Decision) -> Tensor:
    """Choose the object farthest from people."""
    return advance(decision, clearance(decision))


def due(decision: Decision) -> Tensor:
    """Choose the order due soonest: of those that people are away from, and of these those that can still be filled."""
    left = decision.jobs.left.clamp(max=LATEST_S)
    preference = 2.0 * (clearance(decision) > AWAY_M) + 1.0 * (left > FILL_S)
    return advance(decision, 2 * LATEST_S * preference - left)


def greedy(decision: Decision) -> Tensor:
    """Choose the order filled soonest, by a prediction of how people slow the arm, of those that can still be filled.

    The idea is of Faroni et al. (arXiv 2512.17560), who learn how much people slow each job; here distances say it.
    """
    jobs, (near, far) = decision.jobs, SLOW_M
    gap = (jobs.gap - AHEAD_S * jobs.closing).amin(dim=-1)
    share = ((gap - near) / (far - near)).clamp(LEAST_SHARE, 1.0)
    to_object, to_place = jobs.ends[:, :, 0] - decision.state.tcp_pos[:, None], jobs.ends[:, :, 1] - jobs.ends[:, :, 0]
    way = torch.stack([to_object, to_place], dim=2).norm(dim=-1)
    return advance(decision, LATEST_S * (jobs.left > FILL_S) - (way / share).sum(dim=-1))


def cautious(decision: Decision) -> Tensor:
    """Choose the object farthest from people, and wait, where that is allowed, for a person near the goal."""
    state = decision.state
    chosen = advance(decision, clearance(decision))
    index = decision.table.object[chosen]
    picked = state.objects[torch.arange(len(index)), index.clamp(min=0)]
    goal = torch.where((index == NONE)[:, None], state.target_place, picked)
    return waiting(decision, chosen, human_distance(goal, state.humans_pos) < NEAR_M)


def patient(decision: Decision) -> Tensor:
    """Choose as `cautious`, but wait before a pick alone, and the longer the lower the level.

    The distance at which the arm sets out falls from PATIENT_M at level 1, or without a level, to 0 at the last level.
    """
    score, levels = clearance(decision), decision.levels
    ease = ((decision.state.level - 1) / (levels - 1)).nan_to_num(0.0)
    chosen = advance(decision, score)
    way = of_object(decision.table, score).gather(1, chosen[:, None]).squeeze(1)
    picks = decision.table.object[chosen] != NONE
    return waiting(decision, chosen, picks & (way < PATIENT_M * (1 - ease)))


def idle(decision: Decision) -> Tensor:
    """Choose `wait`: the arm stays where it is, and goes home where it cannot."""
    wait = decision.table.position("wait")
    return torch.where(decision.mask[:, wait], wait, in_order(decision))


def fixed(config: EvaluateConfig, table: OptionTable, seed: int) -> Choose:
    """Return the top that chooses the first of `meta_controller.order` that can start, then skills by their numbers."""
    for name in config.meta_controller.order:
        one_of("meta_controller.order", name, tuple(table.names))
    named, first = [table.position(name) for name in config.meta_controller.order], preferred(table).tolist()
    order = torch.tensor([*named, *sorted(set(range(len(table))) - set(named), key=lambda k: (not first[k], k))])
    return lambda decision: order[decision.mask[:, order].int().argmax(dim=1)]


def at_random(config: EvaluateConfig, table: OptionTable, seed: int) -> Choose:
    """Return the top that chooses uniformly among the options that can start, the same in the same episode."""

    def choose(decision: Decision) -> Tensor:
        drawn = uniform(decision.state, len(table), OF_TOPS + seed)
        return torch.where(decision.mask, drawn, -1.0).argmax(dim=1)

    return choose


def learned(config: EvaluateConfig, table: OptionTable, seed: int) -> Choose:
    """Return the trained controller in `policies.meta_controller`."""
    if "meta_controller" not in config.policies:
        raise ConfigError("policies.meta_controller is not given; meta_controller=learned needs it")
    from hrl_comfort.hierarchy.learned import load_choice  # seconds, for torchrl

    found, here = config.policies["meta_controller"], config.meta_controller
    return load_choice(found, config.comfort.levels, table.names, here.max_waits, here.interruption_steps)


def with_waits(rule: Choose) -> MakeTop:
    """Return what makes a rule that waits, and refuses a task without the option."""

    def make(config: EvaluateConfig, table: OptionTable, seed: int) -> Choose:
        if "wait" not in table.names:
            raise ConfigError(
                f"meta_controller={config.meta_controller.name} is for task={', '.join(SORTING)}, which have an option "
                f"to wait; task={config.task.name} takes meta_controller=nearest"
            )
        return rule

    return make


RULES: dict[str, Choose] = implemented(
    RULE_NAMES,
    {"nearest": nearest, "free": free, "due": due, "greedy": greedy, "cautious": cautious, "patient": patient},
)
"""Tops that work, by a function of a decision."""
TOPS: dict[str, MakeTop] = implemented(
    NAMES,
    {
        "nearest": lambda *_: nearest,
        "free": lambda *_: free,
        "due": lambda *_: due,
        "greedy": lambda *_: greedy,
        "cautious": with_waits(cautious),
        "patient": with_waits(patient),
        "idle": with_waits(idle),
        "fixed": fixed,
        "random": at_random,
        "learned": learned,
    },
)
"""Makers of the tops."""
