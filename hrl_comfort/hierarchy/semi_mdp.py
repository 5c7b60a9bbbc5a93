"""The semi-Markov decision process of options in N cells: what an option earns, and how long it lasts."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from hrl_comfort.config import EvaluateConfig
from hrl_comfort.envs.columns import step_columns
from hrl_comfort.hierarchy.executor import OptionExecutor
from hrl_comfort.hierarchy.options import OptionTable
from hrl_comfort.hierarchy.sort import sorting_table
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.tasks import State

MakeOptions = Callable[[Engine], OptionTable]
FLAGS = ("success", "terminated", "truncated")


def options_of(config: EvaluateConfig) -> MakeOptions:
    """Return what makes the options of `sort`, `shift` or `kitting` from their policies.

    It raises ConfigError as `sorting_table` does.
    """

    def make(engine: Engine) -> OptionTable:
        env = engine.episodes.config
        return sorting_table(config.meta_controller, config.policies, engine.scene, env, config.first_seed)

    return make


@dataclass(frozen=True)
class Ran:
    """Options after a step, (N,) each; those of rows that have not ended are of the latest decision.

    An interrupted option has ended here: it is chosen anew, and what it earned and how long it ran count from then on.
    """

    ended: Tensor
    """bool, the option has ended, or is interrupted."""
    reward: Tensor
    """float64, rewards of the option's control steps, each discounted by gamma a control step since it was chosen."""
    duration: Tensor
    """int64, control steps since it was chosen."""
    termination: Tensor
    """int64, index into `executor.TERMINATIONS`."""
    columns: dict[str, Tensor]
    """Of the episode so far: those of FLAGS and of `step_columns`, but for those of a decision."""

    @property
    def terminated(self) -> Tensor:
        """Bool, the episode ended with the option."""
        return self.columns["terminated"]

    @property
    def truncated(self) -> Tensor:
        """Bool, the episode ran out of time with the option."""
        return self.columns["truncated"]

    @property
    def done(self) -> Tensor:
        """Bool."""
        return self.terminated | self.truncated


class SemiMDP:
    """Options chosen by `begin` and run by `step` in the cells of `engine`, whose episodes the caller begins.

    Args:
      engine: of N cells.
      executor: of the options.
      gamma: discount factor of a control step.
    """

    def __init__(self, engine: Engine, executor: OptionExecutor, gamma: float) -> None:
        self.engine, self.executor = engine, executor
        # A table, since the last bit of a vector's powers depends on the place in the vector.
        self._discount = gamma ** torch.arange(engine.episodes.config.task.max_episode_steps, dtype=torch.float64)
        rows = engine.num_envs
        self.returns = torch.zeros(rows, dtype=torch.float64)
        """(N,) rewards of the option in force since it was chosen, discounted."""
        self.earned = torch.zeros(rows, dtype=torch.float64)
        """(N,) rewards of the last step, undiscounted."""
        self._termination = torch.zeros(rows, dtype=torch.int64)
        self._columns: dict[str, Tensor] = {}

    @property
    def state(self) -> State:
        """The state now."""
        state = self.engine.episodes.state
        assert state is not None
        return state

    def begin(self, rows: Tensor, chosen: Tensor) -> None:
        """Start the choices `chosen` (N,) in `rows` (N,) bool; raise ValueError as `OptionExecutor.begin` does."""
        self.executor.begin(rows, chosen)
        self.returns = torch.where(rows, 0.0, self.returns)

    def possible(self, chosen: Tensor) -> Tensor:
        """Return `chosen` (N,) with the first choice that can start in place of each that cannot."""
        able = self.executor.available(self.state)
        return torch.where(able.gather(1, chosen[:, None]).squeeze(1), chosen, able.int().argmax(dim=1))

    def step(self, rows: Tensor, together: bool) -> Ran:
        """Run `rows` (N,) bool until the first of their options has ended, or all of them if `together`.

        The others stand still in time, and with `together` those whose options have ended.
        """
        self.earned = torch.zeros_like(self.earned)
        acting = rows
        while True:
            ended = self._decide(acting)
            if together:
                acting = acting & ~ended
            if not bool(acting.any()) or not (together or not bool(ended.any())):
                break
        ended = rows if together else ended
        duration = self.state.steps - self.executor.decided
        return Ran(ended, self.returns, duration, self._termination, dict(self._columns))

    def _decide(self, acting: Tensor) -> Tensor:
        """Run a decision of the rows `acting` (N,) bool; return those of them that are to decide after it."""
        held = torch.nonzero(~acting).squeeze(-1)
        action = self.executor.act(self.state, acting).numpy()
        with self.engine.held(held) if len(held) else nullcontext(), self.executor.held(held):
            result = self.engine.step(action, np.flatnonzero(acting.numpy()) if len(held) else None)
            options = self.executor.ended(result)
        self._earn(result, acting)
        self._termination = torch.where(acting, options.termination, self._termination)
        columns = {**step_columns(result), **{name: getattr(result, name) for name in FLAGS}}
        for name in ("decision_steps", "human_distance"):
            del columns[name]
        self._columns = {name: torch.where(acting, new, self._columns.get(name, new)) for name, new in columns.items()}
        return options.deciding & acting

    def _earn(self, result: StepResult, acting: Tensor) -> None:
        """Add the rewards of a decision, discounted from the choice of each row's option."""
        count = result.valid.shape[1]
        passed = (result.state.steps - result.decision_steps - self.executor.decided)[:, None] + torch.arange(count)
        valid = result.valid & acting[:, None]
        discount = self._discount[torch.where(valid, passed, 0)]
        paid = torch.where(valid, result.step_rewards, 0.0)
        self.returns = self.returns + (discount * paid).sum(dim=1)
        self.earned = self.earned + paid.sum(dim=1)
