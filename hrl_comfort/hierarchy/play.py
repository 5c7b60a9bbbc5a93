"""One episode in every cell, under a controller."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from hrl_comfort.hierarchy.controllers import Controller
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.step_result import StepResult


@dataclass(frozen=True)
class Moment:
    """One decision of N cells, some of which may have finished before."""

    outcome: StepResult
    active: Tensor
    """(N,) bool: rows whose episode was going on when the decision began."""
    ended: Tensor
    """(N,) bool: rows whose episode ended with it, by itself or given up by the controller."""


def play(engine: Engine, controller: Controller) -> Iterator[Moment]:
    """Yield decision after decision until the episode of every row, begun by `engine.reset`, has ended.

    What a decision says of rows whose episode has ended before is void.
    """
    state = engine.episodes.state
    assert state is not None
    controller.begin(engine.num_envs)
    active = torch.ones(engine.num_envs, dtype=torch.bool)
    while bool(active.any()):
        outcome = engine.step(controller.act(state).numpy(), np.flatnonzero(active.numpy()))
        given_up = controller.observe(outcome)
        moment = Moment(outcome, active, active & (outcome.done | given_up))
        state, active = outcome.state, active & ~moment.ended
        yield moment
