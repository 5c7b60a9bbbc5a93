"""Balls through an episode: which one is aimed at, held, placed or lost, and where each is drawn.

All are functions of State; which stages pick and which place is the subtask's to say.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.tasks import State, Subtask


def in_stage(name: str, stage: Tensor, task: Subtask) -> Tensor:
    """Return (N,) whether the stage (N,) has this name; when all are done it has none."""
    found = torch.zeros_like(stage, dtype=torch.bool)
    for index, item in enumerate(task.stages):
        if item.name == name:
            found = found | (stage == index)
    return found


def aimed(state: State, rows: Tensor, ball: Tensor, task: Subtask) -> State:
    """Return the state in which `rows` (r,) pick the balls (r,) next.

    Raises:
      ValueError: a row is not to pick now, or the ball has been placed.
    """
    here, index = state.rows(rows), torch.arange(len(rows))
    if bool((~in_stage("pick", here.stage, task) | here.placed[index, ball]).any()):
        raise ValueError(f"balls {ball.tolist()} cannot be picked now in rows {rows.tolist()}")
    chosen = here.with_(
        target=ball,
        ball_pos=here.balls[index, ball],
        colour=here.colours[index, ball],
        drop_pos=here.drops[index, ball],
    )
    return state.put(rows, chosen)


def noted(state: State, before: Tensor, task: Subtask) -> State:
    """Return the state with what was placed since the stages `before` (N,), aimed at the next ball if due."""
    further = state.stage > before
    if not further.any():
        return state
    rows = torch.nonzero(in_stage("place", before, task) & further).squeeze(1)
    if len(rows):
        placed = state.placed.clone()
        placed[rows, state.target[rows]] = True
        state = state.with_(placed=placed)
    left = ~state.placed
    due = in_stage("pick", state.stage, task) & further & left.any(dim=1)
    rows = torch.nonzero(due).squeeze(1)
    return aimed(state, rows, left[rows].int().argmax(dim=1), task) if len(rows) else state


def drawn(state: State, task: Subtask) -> NDArray[np.float64]:
    """Return where the balls are drawn (N, B, 3), m: on their table, on the gripper or at a drop point."""
    names = [stage.name for stage in task.stages]
    # A lone pick ends with the ball on the gripper; whatever else is over has left it at its drop point.
    names.append("place" if names[-1] == "pick" else "return")
    stage, count = state.stage.numpy(), state.balls.shape[1]
    own = state.target.numpy()[:, None] == np.arange(count)
    held, left = (np.array([name == which for name in names])[stage, None] for which in ("place", "return"))
    dropped = state.placed.numpy() | (own & left)
    balls = np.where(dropped[..., None], state.drops.numpy(), state.balls.numpy())
    return np.where((own & held)[..., None], state.tcp_pos.numpy()[:, None], balls)
