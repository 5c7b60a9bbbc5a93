"""Observation terms: pure functions of `State`, of order one.

Lengths are metres, angles are scaled by pi, velocities by the servo's speed. Positions of the human are
clamped to `HORIZON_M`, so that an absent person is a bounded number.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from hrl_comfort.tasks.state import State
from hrl_comfort.tasks.subtask import ObjectAt, Stage, StateFunction, by_stage

HORIZON_M = 2.0
"""Largest coordinate of the human that is observed; the arm reaches about 0.7 m."""
SERVO_SPEED = math.radians(100.0)
"""rad/s: 2 degrees every 20 ms."""


def joint_angles(state: State) -> Tensor:
    """Return (N, 2 J): sine and cosine of the joints."""
    return torch.cat([state.joint_pos.sin(), state.joint_pos.cos()], dim=-1)


def joint_error(state: State) -> Tensor:
    """Return (N, J): joint angles from home, unwrapped, in units of pi: a full turn is not home."""
    return (state.joint_pos - state.joint_home) / math.pi


def joint_velocity(state: State) -> Tensor:
    """Return (N, J): joint velocity over the servo's speed."""
    return state.joint_vel / SERVO_SPEED


def pending(state: State) -> Tensor:
    """Return (N, J): the way from the joints to their set-points, in units of pi: what was commanded and is to come."""
    return (state.joint_target - state.joint_pos) / math.pi


def tool(state: State) -> Tensor:
    """Return (N, 3): m, tool centre point."""
    return state.tcp_pos


def human(state: State) -> Tensor:
    """Return (N, 2): m, the human as seen nearest to the tool, from the robot's base."""
    return seen_nearest(state, state.humans_seen).clamp(-HORIZON_M, HORIZON_M)


def seen_nearest(state: State, values: Tensor) -> Tensor:
    """Return (N, n) of `values` (N, P, n): those of the human who is seen nearest to the tool."""
    if values.shape[1] == 1:
        return values[:, 0]
    return torch.take_along_dim(values, _nearest(state)[:, None, None], dim=1)[:, 0]


def nearest_alone(state: State) -> State:
    """Return the state with one human: the one who is seen nearest to the tool."""
    if state.humans_seen.shape[1] == 1:
        return state
    count = state.humans_seen.shape[1]
    index = torch.arange(len(state.humans_seen)), _nearest(state)
    people = {name: value for name, value in state.fields().items() if name.startswith("humans_")}
    return state.with_(**{name: value.unflatten(1, (count, -1))[index] for name, value in people.items()})


def _nearest(state: State) -> Tensor:
    """Return which human (N,) is seen nearest to the tool."""
    return (state.humans_seen - state.tcp_pos[:, None, :2]).norm(dim=-1).argmin(dim=1)


def human_from_tool(state: State) -> Tensor:
    """Return (N, 3): m, the human as seen from the tool (x, y), and the horizontal distance."""
    offset = human(state) - state.tcp_pos[:, :2]
    return torch.cat([offset, offset.norm(dim=-1, keepdim=True)], dim=-1)


def share(state: State) -> Tensor:
    """Return (N, 1): the part of the speed asked for that the shield passed last."""
    return state.share[:, None]


def goal_offset(stages: tuple[Stage, ...]) -> StateFunction:
    """Return the term (N, 4) m: from the tool to the goal of the stage in force, and its length."""
    goal = by_stage(stages, lambda stage: stage.goal)

    def term(state: State) -> Tensor:
        offset = goal(state) - state.tcp_pos
        return torch.cat([offset, offset.norm(dim=-1, keepdim=True)], dim=-1)

    return term


def stage_in_force(stages: tuple[Stage, ...]) -> StateFunction:
    """Return the term (N, stages): one-hot of the stage in force."""

    def term(state: State) -> Tensor:
        index = state.stage.clamp(max=len(stages) - 1)
        return torch.nn.functional.one_hot(index, len(stages)).to(state.tcp_pos.dtype)

    return term


def standard(stages: tuple[Stage, ...]) -> dict[str, StateFunction]:
    """Return the project's observation: joints, tool, human, goal, and the stage where there are several."""
    terms: dict[str, StateFunction] = {
        "joint_angles": joint_angles,
        "joint_error": joint_error,
        "joint_velocity": joint_velocity,
        "tool": tool,
        "human": human,
        "human_from_tool": human_from_tool,
        "goal_offset": goal_offset(stages),
    }
    if len(stages) > 1:
        terms["stage"] = stage_in_force(stages)
    return terms


def set_points(stages: tuple[Stage, ...]) -> dict[str, StateFunction]:
    """Return the project's observation and `pending`: where an arm is bound for whose set-points come late."""
    return {**standard(stages), "pending": pending}


def paper(stages: tuple[Stage, ...]) -> dict[str, StateFunction]:
    """Return the 18 numbers of the paper's released code.

    Joint angles (6); human relative to the robot (2); then, while the ball is concerned, tool to ball (3,
    zero once held), robot to the places of the first two kinds (3 each, height zero) and the kind; while returning,
    joint errors in degrees (6), tool to its home (3) and a zero.
    """
    hidden = torch.tensor([stage.object != ObjectAt.ARRIVAL for stage in stages])
    joint_space = torch.tensor([stage.joint_space for stage in stages])

    def term(state: State) -> Tensor:
        index = state.stage.clamp(max=len(stages) - 1)
        held, homeward = hidden[index], joint_space[index]
        flat = torch.tensor([1.0, 1.0, 0.0], dtype=state.tcp_pos.dtype)
        way = torch.where(held[:, None], 0.0, state.target_object - state.tcp_pos)
        first, second = (state.kind_places[:, kind] * flat for kind in range(2))
        carrying = torch.cat([way, first, second, state.target_kind[:, None]], dim=-1)
        returning = torch.cat(
            [
                torch.rad2deg(state.joint_home - state.joint_pos),
                state.tcp_home - state.tcp_pos,
                torch.zeros_like(state.tcp_pos[:, :1]),
            ],
            dim=-1,
        )
        rest = torch.where(homeward[:, None], returning, carrying)
        return torch.cat([state.joint_pos, human(state), rest], dim=-1)

    return {"paper": term}
