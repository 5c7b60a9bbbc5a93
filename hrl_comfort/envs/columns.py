"""Values that the batched fronts report for each decision."""

from __future__ import annotations

import torch
from torch import Tensor

from hrl_comfort.sim.step_result import StepResult


def step_columns(outcome: StepResult) -> dict[str, Tensor]:
    """Return the outcome of a decision by name, (N,) each.

    `success`, `contact`, `unsafe_contact`, `other_collision`: bool, so far in the episode. `steps`,
    `decision_steps`: int64, control steps of the episode and of the decision. `human_distance`: m, mean
    horizontal distance over the decision. `shield_share_mean`, `protective_stops`: so far in the episode, 1 and 0
    without a shield.
    """
    state, count = outcome.state, outcome.decision_steps
    return {
        "success": outcome.success,
        "contact": state.contact,
        "unsafe_contact": state.unsafe_contact,
        "other_collision": state.table_collision | state.self_collision,
        "steps": state.steps,
        "decision_steps": count,
        "human_distance": torch.where(outcome.valid, outcome.human_distance, 0.0).sum(dim=1) / count,
        "shield_share_mean": state.share_sum / state.steps,
        "protective_stops": state.protective_stops,
    }
