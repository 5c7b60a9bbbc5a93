"""Sight: what a policy sees of its cell and of the people in it, the same whichever way the cell is turned.

Vectors are in the frame that turns with the first joint, so that a policy carries over to places it was not trained
with. People are seen by how near their nearest part is to the hand, the arm, the way and the goal, and how fast it
comes nearer: 1 at a touch, 0 from `SEEN_M` on and beside nobody.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.linalg import vector_norm

from hrl_comfort.compiled import contiguous
from hrl_comfort.tasks.observations import kernels
from hrl_comfort.tasks.observations.standard import goal_offset, joint_error, joint_velocity, stage_in_force
from hrl_comfort.tasks.state import ABSENT, State
from hrl_comfort.tasks.subtask import Stage, StateFunction, by_stage

SEEN_M = 1.2
"""Distance from which on people are not seen: personal space (Hall 1966)."""
PACE_M_S = 1.6
"""Speed of people that is 1."""
SURFACES = 3
"""Number of surfaces that are seen, the nearest to the tool."""
FARTHEST_M = 1.0
"""Largest coordinate of a surface that is seen."""
NEAR_M, ALONG = 0.3, 5
"""Distance from which on nothing is near a part of the arm, and points along the part that are measured."""
AWAY_M = 100.0
"""Largest coordinate, m, and speed, m/s, that is reckoned with; nobody is farther away."""
LEAST_M = 1e-9
"""Length of the vector to a top from a point on it; no vector is shorter."""


def turned(state: State, vectors: Tensor) -> Tensor:
    """Return vectors (N, ..., 3) in the frame that turns with the first joint."""
    pan = state.joint_pos[:, 0].reshape(-1, *[1] * (vectors.ndim - 2))
    cos, sin, x, y = pan.cos(), pan.sin(), vectors[..., 0], vectors[..., 1]
    return torch.stack([cos * x + sin * y, cos * y - sin * x, vectors[..., 2]], dim=-1)


def joints(state: State) -> Tensor:
    """Return (N, 2 (J - 1)): sine and cosine of all joints but the first."""
    return torch.cat([state.joint_pos[:, 1:].sin(), state.joint_pos[:, 1:].cos()], dim=-1)


def tool(state: State) -> Tensor:
    """Return (N, 3): m, tool centre point."""
    return turned(state, state.tcp_pos)


def goal(stages: tuple[Stage, ...]) -> StateFunction:
    """Return the term (N, 4) m: from the tool to the goal of the stage in force, and its length."""
    offset = goal_offset(stages)

    def term(state: State) -> Tensor:
        seen = offset(state)
        return torch.cat([turned(state, seen[:, :3]), seen[:, 3:]], dim=-1)

    return term


def surfaces(state: State) -> Tensor:
    """Return (N, 3 SURFACES): m, from the tool to the nearest point of each of the nearest surfaces, nearest first.

    Surfaces are the tops of places and obstacles; where there are fewer, the others are far away.
    """
    nearest = to_tops(state.tcp_pos[:, None], state.tops)[:, 0]
    order = vector_norm(nearest, dim=-1).argsort(dim=1)[:, :SURFACES]
    seen = turned(state, nearest).gather(1, order[..., None].expand(-1, -1, 3)).clamp(-FARTHEST_M, FARTHEST_M)
    missing = SURFACES - seen.shape[1]
    if missing > 0:
        seen = torch.cat([seen, torch.full_like(seen[:, :1], FARTHEST_M).expand(-1, missing, -1)], dim=1)
    return seen.flatten(1)


def to_tops(points: Tensor, tops: Tensor) -> Tensor:
    """Return the vectors (N, Q, F, 3) m from points (N, Q, 3) m to the nearest point of each of `State.tops`."""
    tops = tops[:, None]
    away = points[:, :, None] - tops[..., :3]
    cos, sin = tops[..., 5].cos(), tops[..., 5].sin()
    along, across = cos * away[..., 0] + sin * away[..., 1], cos * away[..., 1] - sin * away[..., 0]
    u, v = (
        torch.minimum(torch.maximum(each, -half), half)
        for each, half in ((along, tops[..., 3]), (across, tops[..., 4]))
    )
    return torch.stack([cos * u - sin * v, sin * u + cos * v, torch.zeros_like(u)], dim=-1) - away


def clearances(state: State) -> Tensor:
    """Return (N, 3 A): how near each part of the arm is to what stands there: a vector, 1 long at a touch.

    It points to the nearest place or obstacle and is 0 from `NEAR_M` on; each counts as solid from its top down. Parts
    of a gripper, of which each hand has others, are left out.
    """
    arm = state.arm_body.clamp(-AWAY_M, AWAY_M)
    shares = torch.linspace(0.0, 1.0, ALONG, dtype=arm.dtype)[:, None]
    points = arm[:, :, None, :3] + shares * (arm[:, :, None, 3:6] - arm[:, :, None, :3])
    vector = to_tops(points.flatten(1, 2), state.tops)
    # Below a top the way out is up, which this least rise says where the vector is 0.
    rise = vector[..., 2:].clamp(max=0.0)
    vector = torch.cat([vector[..., :2], torch.where(rise > -2 * LEAST_M, LEAST_M, rise + LEAST_M)], dim=-1)
    vector = vector.unflatten(1, (arm.shape[1], ALONG)).flatten(2, 3)
    length = vector_norm(vector, dim=-1)
    apart, nearest = length.min(dim=-1)
    nearness = (1 - (apart - arm[..., 6]) / NEAR_M).clamp(0.0, 1.2)
    nearest_vector = vector.gather(2, nearest[..., None, None].expand(-1, -1, 1, 3))[:, :, 0]
    return turned(state, nearest_vector / apart[..., None] * nearness[..., None]).flatten(1)


def people(stages: tuple[Stage, ...]) -> StateFunction:
    """Return the term (N, 10): how near people are to hand, arm, way and goal, how fast that changes, and where.

    Nearness of hand, arm, way and goal (4); closing speeds of the parts nearest to the hand, the arm and the goal (3),
    times their nearness; direction from the hand to the part nearest to it (3), times its nearness.
    """
    where = by_stage(stages, lambda stage: stage.goal)

    def term(state: State) -> Tensor:
        there, hand = (point.clamp(-AWAY_M, AWAY_M) for point in (where(state), state.tcp_pos))
        points = torch.stack([torch.cat([hand, hand], dim=-1), torch.cat([there, there], dim=-1)], dim=1)
        way = torch.cat([hand, there], dim=-1)[:, None]
        bare = torch.cat([points, way], dim=1)
        bare = torch.cat([bare, torch.zeros_like(bare[..., :1])], dim=-1)
        own, hand = state.arm_body, state.hand_body
        own = own if hand.shape == ABSENT.shape else torch.cat([own, hand], dim=1)
        arm, people, moving = (each.clamp(-AWAY_M, AWAY_M) for each in (own, state.humans_body, state.humans_body_vel))
        gap, vector, speed = closest(torch.cat([bare, arm], dim=1), people, moving)
        of_arm = gap[:, 3:].min(dim=1)
        apart = torch.stack([gap[:, 0], of_arm.values, gap[:, 2], gap[:, 1]], dim=1)
        closing = torch.stack([speed[:, 0], speed[:, 3:].gather(1, of_arm.indices[:, None])[:, 0], speed[:, 1]], dim=1)
        near = (1 - apart / SEEN_M).clamp(0.0, 1.2)
        pace = (closing / PACE_M_S).clamp(-1.0, 1.0) * near[:, [0, 1, 3]]
        direction = turned(state, vector[:, 0]) / vector_norm(vector[:, 0], dim=-1, keepdim=True).clamp(min=1e-6)
        return torch.cat([near, pace, direction * near[:, :1]], dim=-1)

    return term


def closest(bodies: Tensor, others: Tensor, moving: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return of each of `bodies` (N, A, 7) the nearest of `others` (N, Q, 7): distance, vector and closing speed.

    Bodies are capsules: ends of the axis (6) and radius, m; `moving` (N, Q, 6) m/s are the velocities of the others'
    ends. Distance (N, A) m, negative in overlap; vector (N, A, 3) m between the axes; speed (N, A) m/s at which the
    other comes nearer.
    """
    given = bodies, others, moving
    # A graph for export holds what defines the kernel.
    if not torch.compiler.is_compiling() and all(each.dtype == torch.float64 for each in given):
        gap, vector, towards = kernels.closest(*contiguous(*(each.numpy() for each in given)))
        return torch.from_numpy(gap), torch.from_numpy(vector), torch.from_numpy(towards)
    p, p_end, q, q_end = (
        bodies[:, :, None, :3], bodies[:, :, None, 3:6], others[:, None, :, :3], others[:, None, :, 3:6],
    )  # fmt: skip
    d, e, r = p_end - p, q_end - q, p - q
    aa, ee = (d * d).sum(-1).clamp(min=1e-12), (e * e).sum(-1).clamp(min=1e-12)
    b, c, f = (d * e).sum(-1), (d * r).sum(-1), (e * r).sum(-1)
    slant = aa * ee - b * b
    s = torch.where(slant > 1e-12, (b * f - c * ee) / slant.clamp(min=1e-12), torch.zeros_like(slant)).clamp(0.0, 1.0)
    t = ((b * s + f) / ee).clamp(0.0, 1.0)
    s = ((b * t - c) / aa).clamp(0.0, 1.0)
    vector = q + e * t[..., None] - p - d * s[..., None]
    gap = vector_norm(vector, dim=-1) - bodies[:, :, None, 6] - others[:, None, :, 6]
    nearest = gap.argmin(dim=-1, keepdim=True)
    each = nearest[..., None].expand(-1, -1, -1, 3)
    picked = vector.gather(2, each)[:, :, 0]
    ends = moving[:, None].expand(-1, bodies.shape[1], -1, -1)
    speeds = ends[..., :3] + (ends[..., 3:] - ends[..., :3]) * t[..., None]
    speed = speeds.gather(2, each)[:, :, 0]
    towards = -(speed * picked).sum(-1) / vector_norm(picked, dim=-1).clamp(min=1e-6)
    return gap.gather(2, nearest)[..., 0], picked, towards


def sight(stages: tuple[Stage, ...]) -> dict[str, StateFunction]:
    """Return the observation of sight: joints, tool, goal, surfaces, people, and the stage where there are several."""
    terms: dict[str, StateFunction] = {
        "joint_angles": joints,
        "joint_error": joint_error,
        "joint_velocity": joint_velocity,
        "tool": tool,
        "goal_offset": goal(stages),
        "surfaces": surfaces,
        "clearances": clearances,
        "people": people(stages),
    }
    if len(stages) > 1:
        terms["stage"] = stage_in_force(stages)
    return terms
