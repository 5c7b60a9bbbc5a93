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
from hrl_comfort.tasks.subtask import StateFunction

NEVER = 2**62


class Termination(Enum):
    """Ways in which an option ends."""

    SUCCESS = "success"
    FAILURE = "failure"
    PREEMPTED = "preempted"


@dataclass(frozen=True)
class Option:
    """A subtask with a frozen policy for it, the skill of some stages of a longer task."""

    name: str
    subtask: Subtask
    policy: Act
    first: int = 0
    """First of its stages in the longer task; the policy sees stages counted from here."""
    round_stages: int = 0
    """Stages of a round, in a task of several rounds (`sort`)."""
    object: int | None = None
    """Index of the object that a pick is for."""
    level: float | None = None
    """Comfort level that the policy is given instead of the one in force."""

    @property
    def last(self) -> int:
        """One past its last stage, in the first round."""
        return self.first + len(self.subtask.stages)

    def can_start(self, state: State) -> Tensor:
        """Return (N,) bool: one of its stages is in force, and its object is not placed."""
        stage = state.stage - self._round(state.stage)
        able = (stage >= self.first) & (stage < self.last)
        return able if self.object is None else able & ~state.placed[:, self.object]

    def stages(self, stage: Tensor) -> tuple[Tensor, Tensor]:
        """Return its first stage and one past its last, in the round of the stages (N,) in force."""
        start = self._round(stage)
        return start + self.first, start + self.last

    def own_stage(self, stage: Tensor) -> Tensor:
        """Return the stages (N,) int64 counted from the option's first, in this round."""
        return (stage - self._round(stage) - self.first).clamp(min=0)

    def _round(self, stage: Tensor) -> Tensor:
        return stage - stage % self.round_stages if self.round_stages else torch.zeros_like(stage)


@dataclass(frozen=True)
class IdleOption:
    """An option that does not advance the task: it lasts `max_steps` control steps, or until `done`.

    One with a `done` takes the arm home; it follows every preempted skill (`OptionExecutor.available`).
    """

    name: str
    policy: Act
    fits: StateFunction
    """(N,) bool, where it can be chosen."""
    max_steps: int = NEVER
    max_runs: int | None = None
    """Times in a row that it can be chosen; None: any number."""
    done: StateFunction | None = None
    object: None = None
    level: None = None

    def can_start(self, state: State) -> Tensor:
        """Return (N,) bool: it fits, and is not done already."""
        fits = self.fits(state)
        return fits if self.done is None else fits & ~self.done(state)

    def is_over(self, state: State, lasted: Tensor) -> Tensor:
        """Return (N,) bool: it is done, or has lasted (N,) its control steps."""
        over = lasted >= self.max_steps
        return over if self.done is None else over | self.done(state)

    def stages(self, stage: Tensor) -> tuple[Tensor, Tensor]:
        """Return the stage in force and one that is never reached, (N,) each."""
        return stage, torch.full_like(stage, NEVER)

    def own_stage(self, stage: Tensor) -> Tensor:
        """Return zeros (N,) int64: it has no stages."""
        return torch.zeros_like(stage)


def chain(skills: Sequence[tuple[Subtask, Act]]) -> list[Option]:
    """Return an option a skill, each with the stages after those of the one before."""
    options: list[Option] = []
    for subtask, policy in skills:
        options.append(Option(subtask.name, subtask, policy, options[-1].last if options else 0))
    return options


def act(options: Sequence[Option | IdleOption], option: Tensor, state: State, acting: Tensor) -> Tensor:
    """Return the actions (N, A) of the options in force, `option` (N,) int64; rows not `acting` stand still.

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
    seen, action = state.with_(stage=stage, level=level), state.joint_pos.new_zeros(0)
    for index, acts in enumerate(policies):
        rows = torch.nonzero(policy == index).squeeze(-1)
        if len(rows):
            chosen = acts(seen.rows(rows)).to(action.dtype)
            if not len(action):
                action = chosen.new_zeros(len(option), chosen.shape[-1])
            action[rows] = chosen
    return action
