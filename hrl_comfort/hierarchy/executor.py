"""Which option runs in which cell, since when, and how it ends."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from hrl_comfort.comfort.adapt import max_episode_steps
from hrl_comfort.hierarchy.options import IdleOption, Option, Termination, act
from hrl_comfort.sim.episodes import Episodes
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.tasks import State

TERMINATIONS = tuple(Termination)
"""What the numbers of `Ended.ending` stand for."""


@dataclass(frozen=True)
class Ended:
    """What became of the options of N rows in one decision."""

    rows: Tensor
    """(N,) bool, the option has ended."""
    termination: Tensor
    """(N,) int64, an index of TERMINATIONS; 0 where it has not ended."""


class OptionExecutor:
    """The options in force in N cells; a skill runs for `limit` control steps at most.

    Where `comfort` lets an episode last longer at lower levels, a skill may too.
    """

    def __init__(self, options: list[Option | IdleOption], limit: int, episodes: Episodes) -> None:
        self.options, self.limit, self._episodes = options, limit, episodes
        self.option = torch.zeros(episodes.rows, dtype=torch.int64)
        self.started = torch.zeros(episodes.rows, dtype=torch.int64)
        self._until = torch.zeros(episodes.rows, dtype=torch.int64)
        self._from = torch.zeros(episodes.rows, dtype=torch.int64)
        self._preempted = torch.zeros(episodes.rows, dtype=torch.bool)
        """(N,) bool, the last option was preempted, and none has begun since."""
        home = [(k, o.done) for k, o in enumerate(options) if isinstance(o, IdleOption) and o.done is not None]
        self._home = home[0] if home else None

    _TENSORS = ("option", "started", "_until", "_from", "_preempted")

    def state_dict(self) -> dict[str, Tensor]:
        """Return what a bit-for-bit continuation needs."""
        return {name: getattr(self, name) for name in self._TENSORS}

    def load_state_dict(self, saved: dict[str, Tensor]) -> None:
        """Continue from `state_dict`."""
        for name in self._TENSORS:
            setattr(self, name, saved[name])

    def available(self, state: State) -> Tensor:
        """Return (N, K) bool: options that can start now; where none can, each may (the episode is over).

        What is preempted leaves the arm where no skill was trained to begin, and may be stuck: if one of the
        options goes home, only that can start until the arm is there.
        """
        mask = torch.stack([option.can_start(state) for option in self.options], dim=-1)
        if self._home is not None:
            retreat, home = self._home
            astray = self._preempted & ~home(state)
            mask[astray] = False
            mask[astray, retreat] = True
        return mask | ~mask.any(dim=-1, keepdim=True)

    def begin(self, rows: Tensor, chosen: Tensor) -> State:
        """Start the options `chosen` (N,) in `rows` (N,) bool; return the state, aimed at the balls chosen.

        Raises:
          ValueError: one of them cannot start now.
        """
        state = self._episodes.state
        assert state is not None
        allowed = self.available(state).gather(1, chosen[:, None]).squeeze(1)
        if bool((rows & ~allowed).any()):
            row = int(torch.nonzero(rows & ~allowed)[0])
            raise ValueError(f"row {row}: option {self.options[int(chosen[row])].name} cannot start now")
        self.option = torch.where(rows, chosen, self.option)
        self.started = torch.where(rows, state.steps, self.started)
        self._from = torch.where(rows, state.stage, self._from)
        for index, option in enumerate(self.options):
            here = torch.nonzero(rows & (chosen == index)).squeeze(-1)
            if not len(here):
                continue
            self._until[here] = option.ends(state.rows(here))
            if option.ball is not None:
                self._episodes.aim(here, torch.full_like(here, option.ball))
        assert self._episodes.state is not None
        return self._episodes.state

    def act(self, state: State, acting: Tensor | None = None) -> Tensor:
        """Return the actions (N, 6) of the options in force; rows not `acting` (N,) bool stand still."""
        everyone = torch.ones_like(self.option, dtype=torch.bool)
        return act(self.options, self.option, state, everyone if acting is None else acting)

    def ended(self, outcome: StepResult) -> Ended:
        """Return which options have ended with a decision, and how.

        A pause that has lasted its time, or is done, has succeeded; a skill that has lasted the limit is
        preempted, and so is any option where the task is back at an earlier stage: the ball is lost.
        """
        state = outcome.state
        lasted = state.steps - self.started
        over = lasted >= max_episode_steps(outcome.level, self.limit, self._episodes.config.comfort)
        succeeded = state.stage >= self._until
        for index, option in enumerate(self.options):
            if isinstance(option, IdleOption):
                here = self.option == index
                done = lasted >= option.max_episode_steps
                if option.done is not None:
                    done = done | option.done(state)
                succeeded = succeeded | (done & here)
                over = over & ~here
        lost = state.stage < self._from
        # A whole episode's success is that of whatever was running.
        succeeded = (succeeded & ~lost) | outcome.success
        failed = outcome.terminated & ~outcome.success
        ended = succeeded | outcome.done | over | lost
        termination = torch.full_like(self.option, TERMINATIONS.index(Termination.PREEMPTED))
        termination[succeeded] = TERMINATIONS.index(Termination.SUCCESS)
        termination[failed] = TERMINATIONS.index(Termination.FAILURE)
        self._preempted = ended & (termination == TERMINATIONS.index(Termination.PREEMPTED))
        return Ended(ended, torch.where(ended, termination, 0))
