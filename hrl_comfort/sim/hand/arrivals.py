"""Objects that arrive while an episode goes on: they are put at rest into their slots, once these are free."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.safety.geometry import ArmGeometry
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.hand.sensors import Losses
from hrl_comfort.sim.objects import choose_open
from hrl_comfort.tasks import State, Subtask
from hrl_comfort.tasks.hand.observation import turned
from hrl_comfort.tasks.kitting import fetched

Array = NDArray[np.float64]
APART_M, CLEAR_M = 0.005, 0.05
"""Smallest distance of an object that arrives from others, and from the arm and what it may hold."""


class Arrivals:
    """Objects of N cells of `scene` in tasks that repeat their stages."""

    def __init__(self, scene: Scene) -> None:
        self._arm, self._losses = ArmGeometry(scene), Losses(scene)

    def go_on(self, state: State, kinds: Tensor, arrivals: Tensor, turns: Tensor, task: Subtask) -> State:
        """Return the state after a decision, ready for the next contact, with new objects.

        An object that is lost or has been delivered arrives anew, of `kinds` (N,) or, where objects are ordered, of its
        own. It has been delivered when the next round begins, or somebody fetches it. `arrivals` (N, B, kinds, 3) m are
        the centres of objects of each kind where they arrive, turned by `turns` (N, B) rad. What the hand holds stays
        there after a failure; if it is lost, the arm is to pick again.
        """
        state = state.with_(contact=state.touching, unsafe_contact=torch.zeros_like(state.unsafe_contact))
        lost = torch.from_numpy(self._losses(state.objects.numpy(), state.kinds.numpy(), state.carried.numpy()))
        fallen = lost.gather(1, state.target[:, None]).squeeze(1) & task.releasing(state.stage) & ~state.diverged
        delivered = fetched(state) if task.orders else state.placed & task.grasping(state.stage)[:, None]
        due = (lost | delivered) & ~state.diverged[:, None]
        if not bool(due.any()):
            return state
        new = state.kinds if task.orders else kinds[:, None].expand_as(state.kinds)
        centres = torch.take_along_dim(arrivals, new[..., None, None], dim=2).squeeze(2)
        arriving = due & torch.from_numpy(self._free(state, centres.numpy(), new.numpy()))
        state = _laid(state.with_(stage=state.stage - fallen.long()), arriving, new, centres, turns)
        lost &= ~arriving
        return choose_open(state.with_(object_lost=lost.any(dim=1) | state.diverged), task)

    def _free(self, state: State, centres: Array, kinds: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return (N, B) whether objects of `kinds` (N, B) at `centres` (N, B, 3) m are clear of arm and others.

        They stand upright; the others may lie in any way.
        """
        sizes = state.kind_sizes.numpy()
        there, half = (np.take_along_axis(sizes, each[..., None], axis=1) for each in (state.kinds.numpy(), kinds))
        about = np.linalg.norm(there, axis=-1)[:, None] + APART_M
        away = np.abs(centres[:, :, None] - state.objects.numpy()[:, None])
        widths, heights = np.linalg.norm(half[..., :2], axis=-1), half[..., 2]
        wide, high = (each[:, :, None] + about for each in (widths, heights))
        near = (np.hypot(away[..., 0], away[..., 1]) < wide) & (away[..., 2] < high)
        near[:, *np.diag_indices(near.shape[1])] = False
        ends = self._arm.pose(state.joint_pos.numpy()).ends.transpose(3, 1, 2, 0)[:, None]  # (N, 1, C, 2, 3)
        axis, offset = ends[..., 1, :] - ends[..., 0, :], centres[:, :, None] - ends[..., 0, :]
        part = (offset * axis).sum(axis=-1) / np.maximum((axis**2).sum(axis=-1), 1e-12)
        gap = np.linalg.norm(offset - part.clip(0.0, 1.0)[..., None] * axis, axis=-1) - self._arm.radius
        reach = np.hypot(widths, heights) + CLEAR_M
        return np.asarray(~near.any(axis=2) & (gap > reach[..., None]).all(axis=2))


def _laid(state: State, arriving: Tensor, kinds: Tensor, centres: Tensor, turns: Tensor) -> State:
    """Return the state in which objects `arriving` (N, B), of `kinds` (N, B), lie at `centres` (N, B, 3) m.

    They are turned by `turns` (N, B) rad.
    """
    none = torch.zeros_like(turns)
    upright = torch.stack([(turns / 2).cos(), none, none, (turns / 2).sin()], dim=-1)
    back = (state.tcp_quat * state.tcp_quat.new_tensor([1.0, -1.0, -1.0, -1.0]))[:, None].expand_as(upright)
    fresh = {
        "objects": centres, "kinds": kinds, "objects_quat": upright, "objects_vel": torch.zeros_like(centres),
        "pads": torch.zeros_like(state.pads), "ground": centres[..., 2], "placed": torch.zeros_like(state.placed),
        "aloft_steps": torch.zeros_like(state.aloft_steps), "free_steps": torch.zeros_like(state.free_steps),
        "carried": torch.zeros_like(state.carried), "held_at": turned(back, centres - state.tcp_pos[:, None]),
    }  # fmt: skip
    chosen = {name: arriving.reshape(*arriving.shape, *[1] * (value.ndim - 2)) for name, value in fresh.items()}
    return state.with_(**{name: torch.where(chosen[name], fresh[name], getattr(state, name)) for name in fresh})
