"""Kitting: one order for each kind of object is open at a time and due by a time; people fetch what was placed.

A shift of pick, place and return. An order whose object is not placed in time is missed, and a new one is open. One
whose object is placed is closed until somebody fetches the object; then the next one is open.
"""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor

from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.tasks.cycle import CYCLE
from hrl_comfort.tasks.shift import repeated
from hrl_comfort.tasks.standard import standard_subtask
from hrl_comfort.tasks.state import State

FETCH_M = 0.55
"""Horizontal distance between somebody's axis and a place at which they fetch what lies there: an arm's length."""
STANDING_M_S = 0.1
"""Speed below which somebody stands still."""


def fetched(state: State) -> Tensor:
    """Return (N, B) bool: the object is placed, and somebody who stands still is at its place."""
    offset = state.object_places[..., :, None, :2] - state.humans_pos[..., None, :, :]
    there = (offset.norm(dim=-1) < FETCH_M) & (state.humans_vel.norm(dim=-1) < STANDING_M_S)[..., None, :]
    return state.placed & there.any(dim=-1)


def missed(before: State, after: State) -> Tensor:
    """Return the number of open orders that become due within the step."""
    begun, now = (each.steps[..., None] * CONTROL_STEP_S for each in (before, after))
    due = ~before.placed & (before.due > begun) & (before.due <= now)
    return due.sum(dim=-1).to(after.tcp_pos.dtype)


_ROUND = standard_subtask("kitting", CYCLE.stages)
KITTING = replace(repeated(replace(_ROUND, rewards={**_ROUND.rewards, "missed": missed})), orders=True)
