"""The one executor of options: which runs in each of N cells, since when, and how it ends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from hrl_comfort.comfort.adapt import max_episode_steps
from hrl_comfort.files.versions import EXECUTOR, renamed
from hrl_comfort.hierarchy.decision import Decision, Top
from hrl_comfort.hierarchy.options import NONE, OF_FAILURES, Begun, Cause, OptionTable, Termination
from hrl_comfort.policies.draws import OF_ENDS, uniform
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.episodes import Episodes
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.tasks import State

TERMINATIONS = tuple(Termination)
"""Meaning of the numbers in `EndedOptions.termination`."""
_SUCCESS, _FAILURE, _PREEMPTED, _INTERRUPTED = range(len(TERMINATIONS))
CAUSES = tuple(Cause)
"""Meaning of the numbers in `EndedOptions.cause`."""


@dataclass(frozen=True)
class EndedOptions:
    """Options that ended with a decision, by row."""

    rows: Tensor
    """(N,) bool, the option has ended."""
    interrupted: Tensor
    """(N,) bool, it has not, but the top is to decide whether it goes on (Sutton, Precup and Singh 1999, section 4)."""
    termination: Tensor
    """(N,) int64, index into TERMINATIONS; 0 where the top does not decide."""
    cause: Tensor
    """(N,) int64, index into CAUSES; 0 where the option has not ended."""
    given_up: Tensor
    """(N,) bool, an option ran out of time once more than `retries` allows: the episode is over."""

    @property
    def deciding(self) -> Tensor:
        """(N,) bool, the top is to decide, unless the episode is over."""
        return self.rows | self.interrupted


@dataclass(frozen=True)
class OptionRun:
    """One run of an option in one cell; steps are control steps of the episode."""

    row: int
    option: str
    attempt: int
    start_step: int
    end_step: int
    termination: str
    cause: str
    regret: float | None = None
    """By how much the value of the best option was higher when it was chosen (`oracle`); None where nobody judged."""


class OptionExecutor:
    """Options in force in N cells.

    Args:
      table: of which each cell runs one choice at a time.
      episodes: of the cells.
      retries: consecutive further attempts of an option that ran out of time; None: any number.
    """

    _FLAGS = ("_preempted", "_interrupted")
    _TENSORS = ("option", "started", "decided", "stage", "attempt", "timeouts", *_FLAGS)

    def __init__(self, table: OptionTable, episodes: Episodes, retries: int | None = None) -> None:
        self.table, self.retries, self._episodes = table, retries, episodes
        for name in self._TENSORS:
            kind = torch.bool if name in self._FLAGS else torch.int64
            setattr(self, name, torch.zeros(episodes.rows, dtype=kind))

    def anew(self) -> OptionExecutor:
        """Return an executor for the next episodes."""
        return OptionExecutor(self.table, self._episodes, self.retries)

    def copies(self, episodes: Episodes, rows: Tensor) -> OptionExecutor:
        """Return an executor for `episodes` of r cells that go on as those of `rows` (r,) int64 would."""
        fresh = OptionExecutor(self.table, episodes, self.retries)
        fresh.load_state_dict({name: getattr(self, name)[rows] for name in self._TENSORS})
        return fresh

    option: Tensor
    """(N,) int64, index of the choice in force."""
    started: Tensor
    """(N,) int64, control step of the episode at which it started."""
    decided: Tensor
    """(N,) int64, control step at which it was chosen last: when it started or, if it goes on, was interrupted."""
    stage: Tensor
    """(N,) int64, stage of the task at which it started."""
    attempt: Tensor
    """(N,) int64, how often it has been started in a row."""
    timeouts: Tensor
    """(N,) int64, how often a skill has run out of time since one succeeded or lost its object."""
    _preempted: Tensor
    """(N,) bool, the latest option was preempted, or failed and the episode went on; none has started since, but one
    that recovers and has not ended."""
    _interrupted: Tensor
    """(N,) bool, the option in force is interrupted; the top has not decided since."""

    def state_dict(self) -> dict[str, Tensor]:
        """Return what an exact continuation needs."""
        return {name: getattr(self, name) for name in self._TENSORS}

    def load_state_dict(self, saved: dict[str, Tensor]) -> None:
        """Continue from `state_dict`."""
        saved = renamed(saved, EXECUTOR)
        # Of a time when no option was interrupted.
        saved = {"decided": saved["started"], "_interrupted": torch.zeros_like(saved["_preempted"]), **saved}
        saved = {"timeouts": (saved["attempt"] - 1).clamp(min=0), **saved}
        for name in self._TENSORS:
            setattr(self, name, saved[name])

    def available(self, state: State) -> Tensor:
        """Return (N, K) bool: choices that can start; all of them where none can (the episode is over).

        A preempted or failed skill leaves the arm where no skill was trained to start, and may be stuck: if one
        of the options recovers, it alone can start until the arm is home.
        """
        free = self.table.can_start(state)
        mask = free.clone()
        for index, option in enumerate(self.table.options):
            mine = self.table.option == index
            if option.max_runs is not None:
                runs = torch.where(mine[self.option] & (state.steps > 0), self.attempt, 0)
                mask[:, mine] &= (runs < option.max_runs)[:, None]
        going = torch.nonzero(self._interrupted & (state.steps > 0)).squeeze(-1)
        mask[going, self.option[going]] = free[going, self.option[going]]  # to go on is no further run
        for index, option in enumerate(self.table.options):
            mine = self.table.option == index
            if option.recovers:
                astray = self._preempted & (state.steps > 0) & ~self._ends(index, state)
                mask[astray] = mine
        mask = torch.where(mask.any(dim=-1, keepdim=True), mask, free)  # whoever has nothing else may wait once more
        return mask | ~mask.any(dim=-1, keepdim=True)

    def decision(self, state: State, deciding: Tensor | None = None) -> Decision:
        """Return what a top decides on in the rows `deciding` (N,) bool, all by default."""
        rows = torch.ones_like(self._preempted) if deciding is None else deciding
        return Decision(state, self.table, self.available(state), rows, self._episodes.config.comfort.levels)

    def goes_on(self, chosen: Tensor) -> Tensor:
        """Return (N,) bool: the option in force is interrupted, and goes on as it is `chosen` (N,) again."""
        state = self._episodes.state
        assert state is not None
        return self._interrupted & (chosen == self.option) & (state.steps > 0)

    def interrupt(self) -> None:
        """Interrupt the options in force that have run: chosen again they go on, else they end."""
        state = self._episodes.state
        assert state is not None
        self._interrupted = self._interrupted | (state.steps > self.started)

    def left_runs(self, rows: Tensor, chosen: Tensor) -> list[OptionRun]:
        """Return the runs that end as the top, in `rows` (N,) bool, has `chosen` (N,) others where it interrupted."""
        state = self._episodes.state
        assert state is not None
        leaving = torch.nonzero(rows & self._interrupted & ~self.goes_on(chosen)).squeeze(-1).tolist()
        return [self._run(row, Termination.INTERRUPTED, Cause.INTERRUPTED, int(state.steps[row])) for row in leaving]

    def begin(self, rows: Tensor, chosen: Tensor) -> State:
        """Start the choices `chosen` (N,) in `rows` (N,) bool; return the state, the objects chosen as targets.

        An interrupted option that is chosen again goes on: its time, stage and attempt stay.

        Raises:
          ValueError: one of them cannot start now.
        """
        state = self._episodes.state
        assert state is not None
        allowed = self.available(state).gather(1, chosen[:, None]).squeeze(1)
        if bool((rows & ~allowed).any()):
            row = int(torch.nonzero(rows & ~allowed)[0])
            raise ValueError(f"row {row}: option {self.table.names[int(chosen[row])]} cannot start now")
        self.decided = torch.where(rows, state.steps, self.decided)
        rows, self._interrupted = rows & ~self.goes_on(chosen), self._interrupted & ~rows
        again = torch.where((chosen == self.option) & (state.steps > 0), self.attempt + 1, 1)
        self.attempt = torch.where(rows, again, self.attempt)
        begins = rows & (state.steps == 0)
        self.timeouts, self._preempted = torch.where(begins, 0, self.timeouts), self._preempted & ~begins
        self.option = torch.where(rows, chosen, self.option)
        self.started = torch.where(rows, state.steps, self.started)
        self.stage = torch.where(rows, state.stage, self.stage)
        objects = self.table.object[chosen]
        if len(aiming := torch.nonzero(rows & (objects != NONE)).squeeze(-1)):
            self._episodes.aim(aiming, objects[aiming])
        assert self._episodes.state is not None
        return self._episodes.state

    def act(self, state: State, acting: Tensor | None = None) -> Tensor:
        """Return the actions (N, A) of the options in force in the present `state`.

        Rows not `acting` (N,) bool stand still.
        """
        everyone = torch.ones_like(self.option, dtype=torch.bool)
        return self.table.act(self.option, self._episodes.observed(state), everyone if acting is None else acting)

    def ended(self, result: StepResult) -> EndedOptions:
        """Return the options that ended with a decision, and how, and those that are interrupted.

        An option succeeds where its termination says so, and is preempted at its time limit, where the task falls
        back to an earlier stage (the object is lost) and where the episode is truncated.
        """
        state, begun = result.state, self._begun(result.state)
        succeeded, late, lost, interrupted = (torch.zeros_like(self._preempted) for _ in range(4))
        for index, option in enumerate(self.table.options):
            mine = self.table.option[self.option] == index
            succeeded |= mine & self._ends(index, state)
            lost |= mine & option.fallen_back(state, begun)
            if option.interruption_steps is not None:
                interrupted |= mine & (state.steps - self.decided >= option.interruption_steps)
            if option.time_limit is not None:
                limit = max_episode_steps(result.level, option.time_limit, self._episodes.config.comfort)
                late |= mine & (begun.lasted >= limit)
        # The success of the whole episode is that of whichever option was running.
        succeeded = (succeeded & ~lost) | result.success
        ended = succeeded | result.done | result.failed | late | lost
        termination = torch.full_like(self.option, _PREEMPTED)
        termination[succeeded] = _SUCCESS
        termination[result.failed] = _FAILURE
        # Who is on the way home after such an end stays so until home, however often that is interrupted.
        recovers = torch.tensor([option.recovers for option in self.table.options])[self.table.option[self.option]]
        cut_short = ended & (termination != _SUCCESS) & ~result.done
        self._preempted = cut_short | (self._preempted & recovers & ~ended)
        self._interrupted = interrupted & ~ended
        self.timeouts = torch.where(
            succeeded | lost, torch.where(recovers, self.timeouts, 0), self.timeouts + late.long()
        )
        given_up = torch.zeros_like(ended)
        if self.retries is not None:
            given_up = late & ~succeeded & ~lost & ~result.done & (self.timeouts > self.retries)
        cause = self._causes(result, termination, lost, late)
        termination = torch.where(ended, termination, self._interrupted * _INTERRUPTED)
        return EndedOptions(ended, self._interrupted, termination, torch.where(ended, cause, 0), given_up)

    def _causes(self, result: StepResult, termination: Tensor, lost: Tensor, late: Tensor) -> Tensor:
        """Return indices into CAUSES (N,) of options that end so, `late` at their limit, their object `lost`."""
        failed, preempted = termination == _FAILURE, termination == _PREEMPTED
        holds = [(preempted, Cause.EPISODE_OVER), (preempted & late, Cause.TIME_LIMIT)]
        holds += [(preempted & lost, Cause.OBJECT_LOST), (failed, Cause.OTHER_FAILURE)]
        if bool(failed.any()):
            names = reversed(self._episodes.subtask.failures)
            holds += [(failed & result.begun(name), OF_FAILURES.get(name, Cause.OTHER_FAILURE)) for name in names]
        found = torch.full_like(self.option, CAUSES.index(Cause.DONE))
        for rows, cause in holds:
            found[rows] = CAUSES.index(cause)
        return found

    @contextmanager
    def held(self, rows: Tensor) -> Iterator[None]:
        """Keep what is known of `rows` (r,) int64 as it is while options of others end."""
        kept = {name: getattr(self, name)[rows] for name in ("timeouts", *self._FLAGS)}
        yield
        for name, flag in kept.items():
            setattr(self, name, getattr(self, name).index_copy(0, rows, flag))

    def _begun(self, state: State) -> Begun:
        return Begun(self.stage, state.steps - self.started)

    def _ends(self, option: int, state: State) -> Tensor:
        """Return (N,) bool: an option terminates, drawn where its termination is a probability."""
        ends = self.table.options[option].termination(state, self._begun(state))
        return ends if ends.dtype == torch.bool else uniform(state, 1, OF_ENDS + option).squeeze(1) < ends

    def run_of(self, row: int, ended: EndedOptions, end_step: int) -> OptionRun:
        """Return the run that ended in `row`."""
        return self._run(row, TERMINATIONS[int(ended.termination[row])], CAUSES[int(ended.cause[row])], end_step)

    def _run(self, row: int, termination: Termination, cause: Cause, end_step: int) -> OptionRun:
        option, attempt, started = (int(each[row]) for each in (self.option, self.attempt, self.started))
        return OptionRun(row, self.table.names[option], attempt, started, end_step, termination.value, cause.value)


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
    """Option runs that ended with it, or before it, as the top chose another option."""


def execute(engine: Engine, executor: OptionExecutor, top: Top) -> Iterator[ExecutedStep]:
    """Yield decision after decision until the episode of every row, begun by `engine.reset`, has ended.

    `top` decides wherever an option has ended or is interrupted; if it decides for all cells together, these wait for
    one another.
    """
    state = engine.episodes.state
    assert state is not None
    active = torch.ones(engine.num_envs, dtype=torch.bool)
    deciding = active
    top.begin(deciding)
    while bool(active.any()):
        left: list[OptionRun] = []
        if bool(deciding.any()) and not (top.together and bool((active & ~deciding).any())):
            chosen = torch.where(deciding, top(executor.decision(state, deciding)), executor.option)
            left = executor.left_runs(deciding, chosen)
            state = executor.begin(deciding, chosen)
            deciding = torch.zeros_like(active)
        acting, held = active & ~deciding, torch.nonzero(deciding).squeeze(-1)
        action, option = executor.act(state, acting), executor.option
        with engine.held(held) if len(held) else nullcontext(), executor.held(held):
            result = engine.step(action.numpy(), np.flatnonzero(acting.numpy()))
            options = executor.ended(result)
        state = engine.episodes.state
        assert state is not None
        rows = torch.nonzero(options.rows & acting).squeeze(-1).tolist()
        runs = [*left, *(executor.run_of(row, options, int(state.steps[row])) for row in rows)]
        ended = acting & (result.done | options.given_up)
        yield ExecutedStep(result, action, option, acting, ended, runs)
        active = active & ~ended
        deciding = (deciding | (options.deciding & acting)) & active
