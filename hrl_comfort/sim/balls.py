"""Balls through an episode, as functions of State: target, placed balls and where each is rendered."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.tasks import Ball, State, Subtask


def target_ball(state: State, rows: Tensor, ball: Tensor, task: Subtask) -> State:
    """Return the state in which the balls (r,) are the next to be picked in `rows` (r,).

    Raises:
      ValueError: a row is not in a picking stage, or the ball has been placed.
    """
    here, index = state.rows(rows), torch.arange(len(rows))
    if bool((~task.grasping(here.stage) | here.placed[index, ball]).any()):
        raise ValueError(f"balls {ball.tolist()} cannot be picked now in rows {rows.tolist()}")
    chosen = here.with_(
        target=ball,
        ball_pos=here.balls[index, ball],
        colour=here.colours[index, ball],
        drop_pos=here.drops[index, ball],
    )
    return state.put(rows, chosen)


def update_placed(state: State, before: Tensor, task: Subtask) -> State:
    """Return the state with the balls placed since the stages `before` (N,), and the next ball as target if due."""
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
    return target_ball(state, rows, remaining[rows].int().argmax(dim=1), task) if len(rows) else state


def go_on(state: State, before: State, failed: Tensor, colours: Tensor, task: Subtask) -> State:
    """Return the state after a decision of a task that repeats: ready for the next contact, with new balls.

    A ball, of colours (N,), arrives where the last one lay before it was placed or lost: when the next round begins, or
    in the failure (N,) in which the gripper lost it.
    """
    state = state.with_(contact=state.touching, unsafe_contact=torch.zeros_like(state.unsafe_contact))
    lost = failed & task.releasing(state.stage)
    rows = torch.nonzero(lost | (task.grasping(state.stage) & (state.stage > before.stage))).squeeze(1)
    if not len(rows):
        return state
    ball, placed, every = before.target[rows], state.placed.clone(), state.colours.clone()
    placed[rows, ball], every[rows, ball] = False, colours[rows]
    return target_ball(state.with_(stage=state.stage - lost.long(), placed=placed, colours=every), rows, ball, task)


def rendered_positions(state: State, task: Subtask) -> NDArray[np.float64]:
    """Return the positions of the balls (N, B, 3), m: on their table, on the gripper or at a drop point."""
    held, dropped = (task.ball_at(place, state.stage).numpy()[:, None] for place in (Ball.TOOL, Ball.DROP))
    target = state.target.numpy()[:, None] == np.arange(state.balls.shape[1])
    dropped = state.placed.numpy() | (target & dropped)
    balls = state.balls.numpy()
    if dropped.any():
        balls = np.where(dropped[..., None], state.drops.numpy(), balls)
    return np.where((target & held)[..., None], state.tcp_pos.numpy()[:, None], balls)
