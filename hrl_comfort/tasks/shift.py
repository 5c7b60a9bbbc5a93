"""Shift: pick, place and return again and again until time is up; a new object arrives for each placed or lost one.

A failure costs time, not the episode: the object in the gripper is lost, and the arm goes home.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from torch import Tensor

from hrl_comfort.tasks.cycle import CYCLE
from hrl_comfort.tasks.standard import standard_subtask
from hrl_comfort.tasks.state import State
from hrl_comfort.tasks.subtask import StateFunction, Subtask, TransitionFunction


@dataclass(frozen=True)
class WithinRound:
    """A `term` that sees stages counted in their round of `stages`."""

    term: TransitionFunction
    stages: int

    def __call__(self, before: State, after: State) -> Tensor:
        """See `TransitionFunction`."""
        start = before.stage - before.stage % self.stages
        return self.term(before.with_(stage=before.stage - start), after.with_(stage=after.stage - start))


def repeated(task: Subtask) -> Subtask:
    """Return `task` with its stages again after the last one; its terms see stages counted in their round."""

    def observed(term: StateFunction) -> StateFunction:
        return lambda state: term(state.with_(stage=state.stage % len(task.stages)))

    observations = {name: observed(term) for name, term in task.observations.items()}
    count = len(task.stages)
    rewards: dict[str, TransitionFunction] = {name: WithinRound(term, count) for name, term in task.rewards.items()}
    return replace(task, observations=observations, rewards=rewards, repeats=True)


SHIFT = repeated(standard_subtask("shift", CYCLE.stages))
