"""Jobs as a decision shows them; a job is to pick an object where it is and to place it where it belongs."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.linalg import vector_norm

from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.tasks import State


@dataclass(frozen=True)
class Jobs:
    """The jobs of the B objects of N cells; people are where they are, not where they are seen."""

    open: Tensor
    """(N, B) bool, the object is to be picked and placed."""
    ends: Tensor
    """(N, B, 2, 3) m, where the object is picked, and where it belongs."""
    gap: Tensor
    """(N, B, 2, P) m, horizontal distance of each person's axis from both ends."""
    closing: Tensor
    """(N, B, 2, P) m/s, at which `gap` shrinks."""
    left: Tensor
    """(N, B) s until the object is due, below 0 once it was; infinite in tasks without orders."""


def jobs_of(state: State) -> Jobs:
    """Return the jobs of a state."""
    ends = torch.stack([state.objects, state.object_places], dim=2)
    away = state.humans_pos[:, None, None] - ends[..., None, :2]
    gap = vector_norm(away, dim=-1)
    closing = -(away * state.humans_vel[:, None, None]).sum(dim=-1) / gap.clamp(min=1e-6)
    left = state.due - (state.steps * CONTROL_STEP_S)[:, None]
    return Jobs(~state.placed, ends, gap, closing, left)
