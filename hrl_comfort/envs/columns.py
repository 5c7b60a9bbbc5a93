"""Values that the batched fronts report for each decision."""

from __future__ import annotations

import torch
from torch import Tensor

from hrl_comfort.sim.step_result import StepResult


def step_columns(outcome: StepResult) -> dict[str, Tensor]:
    """Return the outcome of a decision by name, (N,) each.

    `success`, `human_collision`, `other_collision`: bool. `steps`, `decision_steps`: int64, control steps of the
    episode and of the decision. `human_distance`: m, mean horizontal distance over the decision.
    """
    state, count = outcome.state, outcome.decision_steps
    return {
        "success": outcome.success,
        "human_collision": state.human_collision,
        "other_collision": state.table_collision | state.self_collision,
        "steps": state.steps,
        "decision_steps": count,
        "human_distance": torch.where(outcome.valid, outcome.human_distance, 0.0).sum(dim=1) / count,
    }
