"""Meta-controllers: which option runs in which cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from hrl_comfort.comfort.adapt import max_episode_steps
from hrl_comfort.config import ComfortConfig, ConfigError, MetaControllerConfig
from hrl_comfort.hierarchy.options import Option, Termination, act
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.tasks import State, Subtask


@dataclass(frozen=True)
class OptionRun:
    """One run of an option in one cell; steps are control steps of the episode."""

    row: int
    option: str
    attempt: int
    start_step: int
    end_step: int
    termination: str


class Controller(Protocol):
    """Says what every row does, decision by decision (`meta_controller.play`)."""

    runs: list[OptionRun]

    def begin(self, rows: int) -> None:
        """Start afresh with N rows."""

    def act(self, state: State) -> Tensor:
        """Return actions (N, 6)."""

    def observe(self, outcome: StepResult) -> Tensor:
        """Note what a decision led to and return (N,) bool: rows whose episode is given up."""


class Scripted:
    """Runs options in their fixed order: the next one when one succeeds, the same again when its time is up.

    An option that has been preempted once more than `retries` allows ends the episode. Where `comfort` lets
    an episode last longer at lower levels, an option may too.
    """

    def __init__(
        self, config: MetaControllerConfig, task: Subtask, options: list[Option], comfort: ComfortConfig
    ) -> None:
        names = [stage.name for option in options for stage in option.subtask.stages]
        expected = [stage.name for stage in task.stages]
        if names != expected:
            raise ConfigError(
                f"meta_controller.options={[o.name for o in options]} do the stages {names}; "
                f"task.name={task.name} needs {expected}"
            )
        self.config, self.options, self.comfort = config, options, comfort
        self.runs: list[OptionRun] = []

    def begin(self, rows: int) -> None:
        """Start afresh with N rows, each at its first option."""
        self._option = torch.zeros(rows, dtype=torch.int64)
        self._started = torch.zeros(rows, dtype=torch.int64)
        self._attempt = torch.zeros(rows, dtype=torch.int64)
        self._over = torch.zeros(rows, dtype=torch.bool)
        self.runs = []

    def act(self, state: State) -> Tensor:
        """Return actions (N, 6): in each row those of the option in force; rows that are over stand still."""
        return act(self.options, self._option, state, ~self._over)

    def observe(self, outcome: StepResult) -> Tensor:
        """Note what a decision led to and return (N,) bool: rows whose episode the controller gives up."""
        state = outcome.state
        failed = outcome.done & ~outcome.success
        given_up = torch.zeros_like(self._over)
        limit = max_episode_steps(outcome.level, self.config.time_limit_steps, self.comfort)
        for row in torch.nonzero(~self._over).squeeze(-1).tolist():
            option = self.options[int(self._option[row])]
            now = int(state.steps[row])
            if bool(failed[row]):
                termination = Termination.PREEMPTED if bool(outcome.truncated[row]) else Termination.FAILURE
                self._end(row, now, termination)
                self._over[row] = True
            elif int(state.stage[row]) >= option.last:
                self._end(row, now, Termination.SUCCESS)
                self._option[row] += 1
                self._attempt[row] = 0
                self._over[row] = bool(outcome.done[row])
            elif int(state.stage[row]) < option.first:
                self._end(row, now, Termination.PREEMPTED)  # the ball is lost: back to whoever takes it
                stages = [o.last for o in self.options]
                self._option[row] = next(i for i, last in enumerate(stages) if int(state.stage[row]) < last)
                self._attempt[row] = 0
            elif now - int(self._started[row]) >= int(limit[row]):
                self._end(row, now, Termination.PREEMPTED)
                self._attempt[row] += 1
                if self._attempt[row] > self.config.retries:
                    self._over[row] = given_up[row] = True
        return given_up

    def _end(self, row: int, now: int, termination: Termination) -> None:
        name = self.options[int(self._option[row])].name
        start = int(self._started[row])
        self.runs.append(OptionRun(row, name, int(self._attempt[row]) + 1, start, now, termination.value))
        self._started[row] = now


def chain(options: list[Option]) -> list[Option]:
    """Return the options with `first` set so that each takes over where the one before it ends."""
    placed, first = [], 0
    for option in options:
        placed.append(Option(option.name, option.subtask, option.policy, first))
        first = placed[-1].last
    return placed


def single(task: Subtask, option: Option, limit: int, comfort: ComfortConfig) -> Scripted:
    """Return the controller of a lone policy: its one option has the episode's limit, control steps."""
    config = MetaControllerConfig(
        name="none", options=[option.name], time_limit_steps=limit, retries=0, level_override=[]
    )
    return Scripted(config, task, [option], comfort)
