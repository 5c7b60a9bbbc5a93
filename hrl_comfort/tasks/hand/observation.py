"""Observation terms of hand and target, in the frame of the tool, so that they carry over to any place and bearing."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.linalg import vector_norm

from hrl_comfort.tasks.state import State
from hrl_comfort.tasks.subtask import StateFunction

FAST = 5.0
"""1/s, velocity of the fingers that is 1: from open to closed in 0.2 s."""
NEAR_M = 0.05
"""Scale of what hand and object are near to: a few millimetres decide whether a grasp holds."""


def of_target(values: Tensor, state: State) -> Tensor:
    """Return those (N, ...) of `values` (N, B, ...) that are the target's."""
    return _chosen(values, state.target)


def _chosen(values: Tensor, index: Tensor) -> Tensor:
    """Return those (N, ...) of `values` (N, n, ...) that `index` (N,) names; any number of rows can be exported."""
    axis = index.ndim
    named = index[..., None] == torch.arange(values.shape[axis])
    mask = named[(..., *[None] * (values.ndim - axis - 1))]
    return torch.where(mask, values, 0).sum(axis).to(values.dtype)


def turned(quaternion: Tensor, vector: Tensor) -> Tensor:
    """Return vectors (..., 3) turned by unit quaternions (..., 4), w first."""
    axis = quaternion[..., 1:].expand(*vector.shape)
    twice = 2 * torch.cross(axis, vector, dim=-1)
    return vector + quaternion[..., :1] * twice + torch.cross(axis, twice, dim=-1)


def in_tool(state: State, vector: Tensor) -> Tensor:
    """Return vectors (N, 3) of the cell in the frame of the tool."""
    return turned(state.tcp_quat * state.tcp_quat.new_tensor([1.0, -1.0, -1.0, -1.0]), vector)


def _axis(like: Tensor, index: int) -> Tensor:
    return torch.eye(3, dtype=like.dtype)[index].expand(like.shape)


def fingers(state: State) -> Tensor:
    """Return (N, 5): the hand from -1, open, to 1; the way to its set-point; its velocity; touch of each pad."""
    moving = torch.stack([2 * state.grip - 1, 2 * (state.grip_target - state.grip), state.grip_vel / FAST], dim=-1)
    return torch.cat([moving, of_target(state.pads, state).to(moving.dtype)], dim=-1)


def target_offset(state: State) -> Tensor:
    """Return (N, 4) m: from the tool to the target in the tool's frame, and its length."""
    offset = state.target_object - state.tcp_pos
    return torch.cat([in_tool(state, offset), vector_norm(offset, dim=-1, keepdim=True)], dim=-1)


def near(vector: Tensor) -> Tensor:
    """Return vectors (N, 3) m in units of NEAR_M, from -1 to 1: fine where they are short."""
    return torch.tanh(vector / NEAR_M)


def target_near(state: State) -> Tensor:
    """Return (N, 3): from the tool to the target in the tool's frame, by `near`."""
    return near(in_tool(state, state.target_object - state.tcp_pos))


def way_near(state: State) -> Tensor:
    """Return (N, 3): from the target to where it belongs, in the tool's frame, by `near`."""
    return near(in_tool(state, state.target_place - state.target_object))


def target_turn(state: State) -> Tensor:
    """Return (N, 6): the x and z axes of the target in the tool's frame."""
    quaternion = of_target(state.objects_quat, state)
    axes = (turned(quaternion, _axis(state.tcp_pos, index)) for index in (0, 2))
    return torch.cat([in_tool(state, axis) for axis in axes], dim=-1)


def target_size(state: State) -> Tensor:
    """Return (N, 3) m: half the sides of the target."""
    return _chosen(state.kind_sizes, state.target_kind)


def target_lifted(state: State) -> Tensor:
    """Return (N, 1) m: height of the target above where it lay."""
    return (state.target_object[..., 2] - of_target(state.ground, state))[..., None]


def target_way(state: State) -> Tensor:
    """Return (N, 3) m: from the target to where it belongs, in the tool's frame."""
    return in_tool(state, state.target_place - state.target_object)


def tool_tilt(state: State) -> Tensor:
    """Return (N, 3): the vertical in the tool's frame."""
    return in_tool(state, _axis(state.tcp_pos, 2))


def pending(state: State) -> Tensor:
    """Return (N, J): the way from the joints to their set-points, in units of pi."""
    return (state.joint_target - state.joint_pos) / math.pi


def hand_terms() -> dict[str, StateFunction]:
    """Return the terms by name."""
    terms = (
        fingers, target_offset, target_near, target_turn, target_size, target_lifted, target_way, way_near, tool_tilt,
        pending,
    )  # fmt: skip
    return {term.__name__: term for term in terms}
