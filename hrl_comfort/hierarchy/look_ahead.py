"""Tops that look ahead: they try every option in copies of the cells.

The value of an option is the return of the next HORIZON_S if it is chosen now and the rule `due` chooses later. The
copies of the oracle are exact, random numbers included: it foresees what no top can know, and nobody reaches a regret
of 0. Those of `lookahead` have futures of their own: it knows how people walk, and not what they will do (Tesauro and
Galperin 1996, https://arxiv.org/abs/2501.05407).
"""

from __future__ import annotations

import torch
from torch import Tensor

from hrl_comfort.config import CONTROL_STEP_S, ConfigError
from hrl_comfort.hierarchy.decision import Decision, Top
from hrl_comfort.hierarchy.executor import OptionExecutor, OptionRun, execute
from hrl_comfort.hierarchy.options import Cause
from hrl_comfort.hierarchy.tops import due
from hrl_comfort.sim.engine import Engine

HORIZON_S = 30.0
"""Time for which both look ahead, s."""
FUTURES = 4
"""Futures over whose returns `lookahead` takes the mean."""


class LookAhead:
    """Values of the options of the cells of `engine`, run by `executor`.

    They are those of the oracle; with `futures` above 0, the means over so many that are drawn for each decision.

    Raises:
      ConfigError: a policy remembers: it would take what its copies did for what it did.
    """

    def __init__(self, engine: Engine, executor: OptionExecutor, futures: int = 0) -> None:
        if name := next(iter(executor.table.remembering), None):
            raise ConfigError(
                f"the policy of {name} remembers, and cannot be tried in copies; give meta_controller "
                "another top, and regret=false"
            )
        self._engine, self.executor, self._futures = engine, executor, futures
        self._latest: tuple[Decision, Tensor] | None = None
        """The decision judged last, and its values: they take long."""

    def __call__(self, decision: Decision) -> Tensor:
        """Return the options (N,) of highest value."""
        return self.values(decision).argmax(dim=1)

    def values(self, decision: Decision) -> Tensor:
        """Return the values (N, K) of the options in the rows that decide among several; -inf where none can start.

        Elsewhere they are 0 for options that can start.
        """
        if self._latest is None or self._latest[0] is not decision:
            self._latest = decision, self._tried(decision)
        return self._latest[1]

    def _tried(self, decision: Decision) -> Tensor:
        """Return the values as `values` does, from copies of the cells."""
        values = torch.zeros(decision.mask.shape, dtype=torch.float64).masked_fill(~decision.mask, -torch.inf)
        several = decision.deciding & (decision.mask.sum(dim=1) > 1)
        rows, tried = torch.nonzero(decision.mask & several[:, None]).unbind(dim=1)
        if len(rows):
            values[rows, tried] = self._returns(rows, tried)
        return values

    def _returns(self, rows: Tensor, tried: Tensor) -> Tensor:
        """Return the returns (r,) of copies of `rows` (r,) that begin with the options `tried` (r,)."""
        if not self._futures:
            return self._worked(rows, tried, None)
        futures = torch.arange(self._futures).repeat_interleave(len(rows))
        every = self._worked(rows.repeat(self._futures), tried.repeat(self._futures), futures)
        return every.reshape(self._futures, -1).mean(dim=0)

    def _worked(self, rows: Tensor, tried: Tensor, futures: Tensor | None) -> Tensor:
        """Return the returns as `_returns` does, in `futures` (r,) if they are given."""
        engine = self._engine.copies(rows, futures)
        executor = self.executor.copies(engine.episodes, rows)
        assert engine.episodes.state is not None
        end = engine.episodes.state.steps + round(HORIZON_S / CONTROL_STEP_S)
        first, returns = torch.ones(len(rows), dtype=torch.bool), torch.zeros(len(rows), dtype=torch.float64)

        def choose(decision: Decision) -> Tensor:
            chosen = torch.where(first, tried, due(decision))
            first[decision.deciding] = False
            return chosen

        for step in execute(engine, executor, Top("tried", choose)):
            within = step.active & (step.result.state.steps <= end)
            returns += torch.where(within, step.result.reward, 0.0)
            if not bool(within.any()):
                break
        engine.close()
        return returns


class Judged(Top):
    """A `top` whose choices an `oracle` judges by the value of the best option less that of the one chosen.

    Raises:
      ConfigError: as `Top`.
    """

    def __init__(self, top: Top, oracle: LookAhead) -> None:
        super().__init__(top.name, top, top.begin, together=True)
        self._oracle = oracle
        self._regret = self._before = torch.zeros(oracle.executor.option.shape, dtype=torch.float64)
        """(N,) of the option in force, over the decisions in which it was chosen, and of the one before."""

    def __call__(self, decision: Decision) -> Tensor:
        """See `Top`."""
        chosen, values = super().__call__(decision), self._oracle.values(decision)
        lost = values.max(dim=1).values - values.gather(1, chosen[:, None]).squeeze(1)
        self._before = self._regret
        lost = lost + torch.where(self._oracle.executor.goes_on(chosen), self._before, 0.0)
        self._regret = torch.where(decision.deciding, lost, self._before)
        return chosen

    def regret(self, run: OptionRun) -> float:
        """Return the regret of a run that ended with the latest step of `execute`."""
        interrupted = run.cause == Cause.INTERRUPTED.value  # another was chosen since
        return float((self._before if interrupted else self._regret)[run.row])
