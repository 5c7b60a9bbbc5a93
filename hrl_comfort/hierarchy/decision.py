"""Decisions that a top sees, and the top that takes them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from hrl_comfort.config import CONTROL_STEP_S, ConfigError
from hrl_comfort.hierarchy.jobs import Jobs, jobs_of
from hrl_comfort.hierarchy.options import OptionTable
from hrl_comfort.tasks import State

KEY = "meta_controller.name"
VALUE, PROBABILITY = "value", "probability"
"""Quantities of an option that a top may give."""


@dataclass(frozen=True)
class Decision:
    """N cells as a top sees them, in some of which it is to choose."""

    state: State
    """With the comfort level in force (`level`)."""
    table: OptionTable
    """The K choices."""
    mask: Tensor
    """(N, K) bool, choices that can start."""
    deciding: Tensor
    """(N,) bool, rows that are to choose; what is chosen elsewhere is ignored."""
    levels: int
    """Number of comfort levels."""

    @property
    def time_s(self) -> Tensor:
        """(N,) s since the episode began."""
        return self.state.steps * CONTROL_STEP_S

    @cached_property
    def jobs(self) -> Jobs:
        """The jobs among which there is a choice."""
        return jobs_of(self.state)


Choose = Callable[[Decision], Tensor]
"""Decision -> indices of choices (N,) int64."""


class Top:
    """A top as a run of episodes calls it: `begin` at each start of an episode, then `choose` at each decision.

    Args:
      name: in errors.
      choose: its choices; a sequence or an array does as well as a tensor.
      begin: called with the rows (N,) bool in which an episode begins.
      together: it is slow, and asked only once every cell is to decide; until then those that are stand still in time.
      values: what it thinks of each option, (N, K) numbers; None: it does not say.
      quantity: what these numbers are, such as VALUE or PROBABILITY.
    """

    def __init__(
        self,
        name: str,
        choose: Choose,
        begin: Callable[[Tensor], object] | None = None,
        together: bool = False,
        values: Callable[[Decision], Tensor] | None = None,
        quantity: str = VALUE,
    ) -> None:
        self.name, self._choose, self._begin, self.together = name, choose, begin, together
        self._values, self.quantity = values, quantity

    def begin(self, rows: Tensor) -> None:
        """Let episodes begin in `rows` (N,) bool."""
        if self._begin is not None:
            self._begin(rows)

    def values(self, decision: Decision) -> Tensor | None:
        """Return what the top thinks of the options, (N, K) float64; None where it does not say.

        Raises:
          ConfigError: they are not N times K numbers.
        """
        if self._values is None:
            return None
        rows, count = decision.mask.shape
        found = self._values(decision)
        try:
            values = torch.as_tensor(found, dtype=torch.float64)
        except (TypeError, ValueError, RuntimeError):
            values = torch.empty(0)
        if values.shape != (rows, count):
            what = f"shape {tuple(values.shape)}" if values.numel() else type(found).__name__
            raise ConfigError(f"{KEY}={self.name!r}: values returned {what}; it must return {rows} x {count} numbers")
        return values

    def __call__(self, decision: Decision) -> Tensor:
        """Return the choices (N,) int64; those of rows that do not decide are arbitrary.

        Raises:
          ConfigError: they are not N indices of choices that can start.
        """
        rows, count = decision.mask.shape
        chosen = self._choose(decision)
        try:
            chosen = torch.as_tensor(chosen)
        except (TypeError, ValueError, RuntimeError):
            found = type(chosen).__name__
            raise ConfigError(
                f"{KEY}={self.name!r} returned {found}; it must return {rows} indices of options"
            ) from None
        if chosen.dtype == torch.bool or chosen.shape != (rows,) or chosen.is_floating_point() or chosen.is_complex():
            found = f"{chosen.dtype} of shape {tuple(chosen.shape)}".removeprefix("torch.")
            raise ConfigError(f"{KEY}={self.name!r} returned {found}; it must return {rows} indices of options")
        chosen = torch.where(decision.deciding, chosen.to(torch.int64), 0)
        allowed = (chosen >= 0) & (chosen < count)
        allowed &= decision.mask.gather(1, chosen.clamp(0, count - 1)[:, None]).squeeze(1)
        if bool((decision.deciding & ~allowed).any()):
            row = int(torch.nonzero(decision.deciding & ~allowed)[0])
            index, names = int(chosen[row]), decision.table.names
            said = names[index] if 0 <= index < count else index
            able = ", ".join(name for name, can in zip(names, decision.mask[row].tolist(), strict=True) if can)
            raise ConfigError(f"{KEY}={self.name!r} chose {said!r} in row {row}, which cannot start now; {able} can")
        return chosen
