"""Objects through an episode, as functions of State: target, placed objects and where each is rendered."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.tasks import ObjectAt, State, Subtask
from hrl_comfort.tasks.kitting import fetched


def choose_target(state: State, rows: Tensor, index: Tensor, task: Subtask) -> State:
    """Return the state in which the objects `index` (r,) are the next to be picked in `rows` (r,).

    Raises:
      ValueError: a row is not in a picking stage, or the object has been placed.
    """
    if bool((~task.grasping(state.stage[rows]) | state.placed[rows, index]).any()):
        raise ValueError(f"objects {index.tolist()} cannot be picked now in rows {rows.tolist()}")
    return state.with_(target=state.target.index_copy(0, rows, index))


def update_placed(state: State, before: Tensor, task: Subtask) -> State:
    """Return the state with the objects placed since the stages `before` (N,), and the next object as target if due."""
    further = state.stage > before
    if not further.any():
        return state
    rows = torch.nonzero(task.releasing(before) & further).squeeze(1)
    if len(rows):
        placed = state.placed.clone()
        placed[rows, state.target[rows]] = True
        state = state.with_(placed=placed)
    remaining = ~state.placed
    due = task.grasping(state.stage) & further & remaining.any(dim=1)
    rows = torch.nonzero(due).squeeze(1)
    return choose_target(state, rows, remaining[rows].int().argmax(dim=1), task) if len(rows) else state


def go_on(state: State, before: State, failed: Tensor, kinds: Tensor, arrivals: Tensor, task: Subtask) -> State:
    """Return the state after a decision of a task that repeats: ready for the next contact, with new objects.

    An object, of `kinds` (N,), arrives in the place of the last one that was placed or lost: when the next round
    begins, or in the failure (N,) in which the gripper lost it. `arrivals` (N, B, kinds, 3) m are the centres of
    objects of each kind where they arrive. Where objects are ordered, a lost one is back where it arrived.
    """
    state = state.with_(contact=state.touching, unsafe_contact=torch.zeros_like(state.unsafe_contact))
    lost = failed & task.releasing(state.stage)
    if task.orders:
        return state.with_(stage=state.stage - lost.long())
    rows = torch.nonzero(lost | (task.grasping(state.stage) & (state.stage > before.stage))).squeeze(1)
    if not len(rows):
        return state
    index, placed, every, centres = (
        before.target[rows],
        *(each.clone() for each in (state.placed, state.kinds, state.objects)),
    )
    placed[rows, index], every[rows, index] = False, kinds[rows]
    centres[rows, index] = arrivals[rows, index, kinds[rows]]
    state = state.with_(stage=state.stage - lost.long(), placed=placed, kinds=every, objects=centres)
    return choose_target(state, rows, index, task)


def renewed(state: State, due: Tensor, task: Subtask, taken: Tensor | None = None) -> State:
    """Return the state after a decision with orders open anew, `due` (N, B) s from now: those fetched or missed.

    `taken` (N, B) are those of which the object has left its place; by default those fetched. Where the arm is to pick
    and the order that it was for is closed, it is for the first open one.
    """
    now, taken = state.steps[:, None] * CONTROL_STEP_S, fetched(state) if taken is None else taken
    again = taken | (~state.placed & (state.due <= now))
    if bool(again.any()):
        state = state.with_(placed=state.placed & ~taken, due=torch.where(again, now + due, state.due))
    return choose_open(state, task)


def choose_open(state: State, task: Subtask) -> State:
    """Return the state in which arms that are to pick an object that is placed are to pick the first that is not."""
    closed = state.placed.gather(1, state.target[:, None]).squeeze(1) & ~state.placed.all(dim=1)
    rows = torch.nonzero(task.grasping(state.stage) & closed).squeeze(1)
    return choose_target(state, rows, (~state.placed[rows]).int().argmax(dim=1), task) if len(rows) else state


def rendered_positions(state: State, task: Subtask) -> NDArray[np.float64]:
    """Return the centres of the objects (N, B, 3), m: where they arrived, on the gripper or where they belong."""
    at = (ObjectAt.TOOL, ObjectAt.PLACE)
    held, left = (task.object_at(where, state.stage).numpy()[:, None] for where in at)
    target = state.target.numpy()[:, None] == np.arange(state.objects.shape[1])
    placed = state.placed.numpy() | (target & left)
    centres = state.objects.numpy()
    if placed.any():
        centres = np.where(placed[..., None], state.object_places.numpy(), centres)
    return np.where((target & held)[..., None], state.tcp_pos.numpy()[:, None], centres)
