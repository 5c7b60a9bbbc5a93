"""What a subtask is: a value made of stages, observations, rewards and a start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from hrl_comfort.tasks.state import State

Quantity = Callable[[State], Tensor]
"""A pure function of one instant."""
Change = Callable[[State, State], Tensor]
"""A pure function of two instants, one control step apart: (before, after) -> (N,)."""


@dataclass(frozen=True)
class Stage:
    """One thing to be done. A subtask is done when its stages are, in order."""

    name: str
    goal: Quantity
    """(N, 3) m, where the tool centre point should go."""
    distance: Quantity
    """(N,) what has to shrink: metres, or the sum of joint errors in rad for home."""
    done: Quantity
    """(N,) bool."""


@dataclass(frozen=True)
class Subtask:
    """A subtask: what the policy sees, is paid for, and when it has succeeded.

    `start` names where its episodes begin: `home`, `taken` (tool at the ball) or `left` (tool at
    the drop point of the ball's colour).
    """

    name: str
    stages: tuple[Stage, ...]
    observations: dict[str, Quantity]
    rewards: dict[str, Change]
    start: str = "home"

    def observe(self, state: State) -> Tensor:
        """Return the observation (N, D), the concatenation of the named terms in their order."""
        return torch.cat([term(state) for term in self.observations.values()], dim=-1)

    def next_stage(self, state: State) -> Tensor:
        """Return the stage (N,) in force after this instant: one further where the present one is done."""
        stage = state.stage
        for index, item in enumerate(self.stages):
            stage = torch.where((state.stage == index) & item.done(state), index + 1, stage)
        return stage

    def success(self, state: State) -> Tensor:
        """Return (N,) bool: every stage is done."""
        return state.stage >= len(self.stages)

    def failure(self, state: State) -> Tensor:
        """Return (N,) bool: the robot touches the human, the workcell or itself."""
        return state.human_collision | state.table_collision | state.self_collision


def by_stage(stages: tuple[Stage, ...], quantity: Callable[[Stage], Quantity]) -> Quantity:
    """Return the quantity of whichever stage is in force (of the last one when all are done)."""
    if len(stages) == 1:
        return quantity(stages[0])

    def select(state: State) -> Tensor:
        value = quantity(stages[-1])(state)
        for index, stage in enumerate(stages[:-1]):
            chosen = (state.stage == index).reshape(-1, *[1] * (value.ndim - 1))
            value = torch.where(chosen, quantity(stage)(state), value)
        return value

    return select
