"""Shift: pick, place and return again and again until time is up; a new object arrives for each placed or lost one.

A failure costs time, not the episode: the object in the gripper is lost, and the arm goes home.
"""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor

from hrl_comfort.tasks.cycle import CYCLE
from hrl_comfort.tasks.standard import standard_subtask
from hrl_comfort.tasks.state import State
from hrl_comfort.tasks.subtask import StateFunction, Subtask, TransitionFunction


def repeated(task: Subtask) -> Subtask:
    """Return `task` with its stages again after the last one; its terms see stages counted in their round."""

    def observed(term: StateFunction) -> StateFunction:
        return lambda state: term(state.with_(stage=state.stage % len(task.stages)))

    def within_round(term: TransitionFunction) -> TransitionFunction:
        def reward(before: State, after: State) -> Tensor:
            start = before.stage - before.stage % len(task.stages)
            return term(before.with_(stage=before.stage - start), after.with_(stage=after.stage - start))

        return reward

    observations = {name: observed(term) for name, term in task.observations.items()}
    rewards = {name: within_round(term) for name, term in task.rewards.items()}
    return replace(task, observations=observations, rewards=rewards, repeats=True)


SHIFT = repeated(standard_subtask("shift", CYCLE.stages))
