"""The one executor of options: which runs in each of N cells, since when, and how it ends."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from hrl_comfort.comfort.adapt import max_episode_steps
from hrl_comfort.hierarchy.options import IdleOption, Option, Termination, act
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.episodes import Episodes
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.tasks import State

TERMINATIONS = tuple(Termination)
"""Meaning of the numbers in `EndedOptions.termination`."""
_SUCCESS, _FAILURE, _PREEMPTED = range(len(TERMINATIONS))


@dataclass(frozen=True)
class Decision:
    """Input of a meta-controller in N cells, in some of which an option has just ended."""

    state: State
    mask: Tensor
    """(N, K) bool, options that can start."""


Choose = Callable[[Decision], Tensor]
"""Meta-controller: decision -> options to start (N,) int64, used in the rows that decide."""


@dataclass(frozen=True)
class EndedOptions:
    """Options that ended with a decision, by row."""

    rows: Tensor
    """(N,) bool, the option has ended."""
    termination: Tensor
    """(N,) int64, index into TERMINATIONS; 0 where the option has not ended."""
    given_up: Tensor
    """(N,) bool, an option ran out of time once more than `retries` allows: the episode is over."""


@dataclass(frozen=True)
class OptionRun:
    """One run of an option in one cell; steps are control steps of the episode."""

    row: int
    option: str
    attempt: int
    start_step: int
    end_step: int
    termination: str


class OptionExecutor:
    """Options in force in N cells.

    Args:
      options: of which each cell runs one at a time.
      time_limit: control steps after which a skill is preempted; longer where `comfort` lets an episode last longer.
      episodes: of the cells.
      retries: consecutive further attempts of an option that ran out of time; None: any number.
    """

    _TENSORS = ("option", "started", "attempt", "_first", "_last", "_preempted")

    def __init__(
        self, options: Sequence[Option | IdleOption], time_limit: int, episodes: Episodes, retries: int | None = None
    ) -> None:
        self.options, self.time_limit, self.retries, self._episodes = list(options), time_limit, retries, episodes
        for name in ("option", "started", "attempt", "_first", "_last"):
            setattr(self, name, torch.zeros(episodes.rows, dtype=torch.int64))
        self._preempted = torch.zeros(episodes.rows, dtype=torch.bool)
        """(N,) bool, the latest option was preempted, or failed and the episode went on; none has started since."""
        retreats = [(k, o.done) for k, o in enumerate(options) if isinstance(o, IdleOption) and o.done is not None]
        self._retreat = retreats[0] if retreats else None
        self._limited = [
            (k, o.max_runs) for k, o in enumerate(options) if isinstance(o, IdleOption) and o.max_runs is not None
        ]

    option: Tensor
    """(N,) int64, option in force."""
    started: Tensor
    """(N,) int64, control step of the episode at which it started."""
    attempt: Tensor
    """(N,) int64, how often it has been started in a row."""
    _first: Tensor
    """(N,) int64, the option is preempted if the task falls back to a stage before this one."""
    _last: Tensor
    """(N,) int64, the option has succeeded at this stage."""

    def state_dict(self) -> dict[str, Tensor]:
        """Return what an exact continuation needs."""
        return {name: getattr(self, name) for name in self._TENSORS}

    def load_state_dict(self, saved: dict[str, Tensor]) -> None:
        """Continue from `state_dict`."""
        for name in self._TENSORS:
            setattr(self, name, saved[name])

    def available(self, state: State) -> Tensor:
        """Return (N, K) bool: options that can start; all of them where none can (the episode is over).

        A preempted or failed skill leaves the arm where no skill was trained to start, and may be stuck: if one
        of the options goes home, it alone can start until the arm is there.
        """
        mask = torch.stack([option.can_start(state) for option in self.options], dim=-1)
        for index, most in self._limited:
            mask[:, index] &= torch.where((self.option == index) & (state.steps > 0), self.attempt, 0) < most
        if self._retreat is not None:
            index, home = self._retreat
            astray = self._preempted & ~home(state)
            mask[astray] = False
            mask[astray, index] = True
        return mask | ~mask.any(dim=-1, keepdim=True)

    def decision(self, state: State) -> Decision:
        """Return what a meta-controller decides on."""
        return Decision(state, self.available(state))

    def begin(self, rows: Tensor, chosen: Tensor) -> State:
        """Start the options `chosen` (N,) in `rows` (N,) bool; return the state, the objects chosen as targets.

        Raises:
          ValueError: one of them cannot start now.
        """
        state = self._episodes.state
        assert state is not None
        allowed = self.available(state).gather(1, chosen[:, None]).squeeze(1)
        if bool((rows & ~allowed).any()):
            row = int(torch.nonzero(rows & ~allowed)[0])
            raise ValueError(f"row {row}: option {self.options[int(chosen[row])].name} cannot start now")
        again = torch.where((chosen == self.option) & (state.steps > 0), self.attempt + 1, 1)
        self.attempt = torch.where(rows, again, self.attempt)
        self.option = torch.where(rows, chosen, self.option)
        self.started = torch.where(rows, state.steps, self.started)
        for index, option in enumerate(self.options):
            here = torch.nonzero(rows & (chosen == index)).squeeze(-1)
            if len(here):
                self._first[here], self._last[here] = option.stages(state.stage[here])
                if option.object is not None:
                    self._episodes.aim(here, torch.full_like(here, option.object))
        assert self._episodes.state is not None
        return self._episodes.state

    def act(self, state: State, acting: Tensor | None = None) -> Tensor:
        """Return the actions (N, A) of the options in force in the present `state`.

        Rows not `acting` (N,) bool stand still.
        """
        everyone = torch.ones_like(self.option, dtype=torch.bool)
        state = self._episodes.observed(state)
        return act(self.options, self.option, state, everyone if acting is None else acting)

    def ended(self, result: StepResult) -> EndedOptions:
        """Return the options that ended with a decision, and how.

        An idle option succeeds when its time is up or it is done. A skill succeeds once its stages are done,
        and is preempted at its time limit. Either is preempted where the task falls back to an earlier stage
        (the object is lost) and where the episode is truncated.
        """
        state = result.state
        lasted = state.steps - self.started
        late = lasted >= max_episode_steps(result.level, self.time_limit, self._episodes.config.comfort)
        succeeded = state.stage >= self._last
        for index, option in enumerate(self.options):
            if isinstance(option, IdleOption):
                here = self.option == index
                succeeded, late = torch.where(here, option.is_over(state, lasted), succeeded), late & ~here
        lost = state.stage < self._first
        # The success of the whole episode is that of whichever option was running.
        succeeded = (succeeded & ~lost) | result.success
        ended = succeeded | result.done | result.failed | late | lost
        termination = torch.full_like(self.option, _PREEMPTED)
        termination[succeeded] = _SUCCESS
        termination[result.failed] = _FAILURE
        self._preempted = ended & (termination != _SUCCESS) & ~result.terminated
        given_up = torch.zeros_like(ended)
        if self.retries is not None:
            given_up = late & ~succeeded & ~lost & ~result.done & (self.attempt > self.retries)
        return EndedOptions(ended, torch.where(ended, termination, 0), given_up)

    def run_of(self, row: int, ended: EndedOptions, end_step: int) -> OptionRun:
        """Return the run that ended in `row`."""
        return OptionRun(
            row,
            self.options[int(self.option[row])].name,
            int(self.attempt[row]),
            int(self.started[row]),
            end_step,
            TERMINATIONS[int(ended.termination[row])].value,
        )


@dataclass(frozen=True)
class ExecutedStep:
    """One decision of N cells, in some of which the episode had ended before; those rows are void."""

    result: StepResult
    action: Tensor
    """(N, A) in [-1, 1]."""
    option: Tensor
    """(N,) int64: option that chose it."""
    active: Tensor
    """(N,) bool: rows whose episode was going on when the decision began."""
    ended: Tensor
    """(N,) bool: rows whose episode ended with it, or was given up."""
    runs: list[OptionRun]
    """Option runs that ended with it."""


def execute(engine: Engine, executor: OptionExecutor, choose: Choose) -> Iterator[ExecutedStep]:
    """Yield decision after decision until the episode of every row, begun by `engine.reset`, has ended.

    `choose` decides wherever an option has ended.
    """
    state = engine.episodes.state
    assert state is not None
    active = torch.ones(engine.num_envs, dtype=torch.bool)
    deciding = active
    while bool(active.any()):
        if bool(deciding.any()):
            chosen = torch.where(deciding, choose(executor.decision(state)), executor.option)
            state = executor.begin(deciding, chosen)
        action, option = executor.act(state, active), executor.option
        result = engine.step(action.numpy(), np.flatnonzero(active.numpy()))
        options, state = executor.ended(result), result.state
        rows = torch.nonzero(options.rows & active).squeeze(-1).tolist()
        runs = [executor.run_of(row, options, int(state.steps[row])) for row in rows]
        ended = active & (result.done | options.given_up)
        yield ExecutedStep(result, action, option, active, ended, runs)
        active = active & ~ended
        deciding = options.rows & active
