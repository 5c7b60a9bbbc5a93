"""Options: one frozen subtask policy each, run until it succeeds, fails or is preempted.

The options framework (Sutton, Precup, Singh 1999): an option acts by its policy until its termination.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import torch
from torch import Tensor

from hrl_comfort.policies.load import Act
from hrl_comfort.tasks import State, Subtask
from hrl_comfort.tasks.subtask import Quantity

NEVER = 2**62


class Termination(Enum):
    """How an option ended."""

    SUCCESS = "success"
    FAILURE = "failure"
    PREEMPTED = "preempted"


@dataclass(frozen=True)
class Option:
    """A subtask with a frozen policy for it.

    `first` is the stage of the longer task at which the option starts; it is responsible for as many stages
    as its subtask has, and sees their index counted from its own. Of a task that goes round several times
    (`sort`), `round_stages` says how many stages a round has, and `ball` which ball a pick is for. Where
    there is a `level`, the policy is told it, instead of the level in force.
    """

    name: str
    subtask: Subtask
    policy: Act
    first: int = 0
    round_stages: int = 0
    ball: int | None = None
    level: float | None = None

    @property
    def last(self) -> int:
        """One past the last stage the option is responsible for, in the first round."""
        return self.first + len(self.subtask.stages)

    def can_start(self, state: State) -> Tensor:
        """Return (N,) bool: its stage is in force, and its ball is not placed."""
        stage = state.stage - self._round(state.stage)
        able = (stage >= self.first) & (stage < self.last)
        return able if self.ball is None else able & ~state.placed[:, self.ball]

    def ends(self, state: State) -> Tensor:
        """Return (N,) int64: the stage at which the option is done if it starts now."""
        return self._round(state.stage) + self.last

    def own_stage(self, stage: Tensor) -> Tensor:
        """Return the stages (N,) int64 counted from the option's own, of this round."""
        return (stage - self._round(stage) - self.first).clamp(min=0)

    def _round(self, stage: Tensor) -> Tensor:
        return stage - stage % self.round_stages if self.round_stages else torch.zeros_like(stage)


@dataclass(frozen=True)
class IdleOption:
    """An option that takes the task no further: it lasts `max_episode_steps`, or until `done`.

    It can be chosen where `fits` says so. One with a `done` takes the arm home: it also follows whatever was
    preempted (`OptionExecutor.available`).
    """

    name: str
    policy: Act
    fits: Quantity
    max_episode_steps: int = NEVER
    done: Quantity | None = None
    ball: None = None
    level: None = None

    def can_start(self, state: State) -> Tensor:
        """Return (N,) bool: where it fits, and is not done already."""
        fits = self.fits(state)
        return fits if self.done is None else fits & ~self.done(state)

    def ends(self, state: State) -> Tensor:
        """Return (N,) int64, a stage that is never reached."""
        return torch.full_like(state.stage, NEVER)

    def own_stage(self, stage: Tensor) -> Tensor:
        """Return zeros (N,) int64: it has no stages."""
        return torch.zeros_like(stage)


def act(options: Sequence[Option | IdleOption], option: Tensor, state: State, acting: Tensor) -> Tensor:
    """Return the actions (N, 6) of the options in force, `option` (N,) int64; rows not `acting` stand still.

    Options that share a policy act in one batch.
    """
    stage, level, policy = state.stage.clone(), state.level.clone(), torch.full_like(option, -1)
    policies = list(dict.fromkeys(each.policy for each in options))
    for index, each in enumerate(options):
        rows = (option == index) & acting
        stage = torch.where(rows, each.own_stage(stage), stage)
        policy[rows] = policies.index(each.policy)
        if each.level is not None:
            level[rows] = each.level
    seen, action = state.with_(stage=stage, level=level), torch.zeros_like(state.joint_pos)
    for index, acts in enumerate(policies):
        rows = torch.nonzero(policy == index).squeeze(-1)
        if len(rows):
            action[rows] = acts(seen.rows(rows)).to(action.dtype)
    return action
