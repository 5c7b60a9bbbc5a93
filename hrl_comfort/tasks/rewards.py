"""Reward terms: named, pure, unweighted; weights are configuration (`conf/reward`).

A term maps the states before and after each of K control steps to (N, K). The reward of a decision is the sum,
over its control steps, of the weighted terms.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import or_

import torch
from torch import Tensor
from torch.linalg import vector_norm

from hrl_comfort.tasks.state import State
from hrl_comfort.tasks.subtask import Stage, TransitionFunction

LATE_STEPS = 150
"""Control steps (3 s) that no episode needs on its way to a goal."""


@dataclass(frozen=True)
class Progress:
    """Decrease of the distance over the step, m or rad, in the stages (not) in joint space."""

    stages: tuple[Stage, ...]
    joint_space: bool

    def __call__(self, before: State, after: State) -> Tensor:
        """See `TransitionFunction`."""
        gain = torch.zeros_like(after.tcp_pos[..., 0])
        for index, stage in enumerate(self.stages):
            others = before.stage != index
            if stage.joint_space is self.joint_space and not others.all():
                shrunk = stage.distance(before) - stage.distance(after)
                gain = gain + shrunk.masked_fill(others, 0.0)
        return gain


@dataclass(frozen=True)
class Completion:
    """1 at the step that completes one of the stages of index `paid`, -1 at one that falls back to it, else 0."""

    paid: tuple[int, ...]

    def __call__(self, before: State, after: State) -> Tensor:
        """See `TransitionFunction`."""
        done = [(before.stage == index) & (after.stage == index + 1) for index in self.paid]
        undone = [(before.stage == index + 1) & (after.stage == index) for index in self.paid]
        dtype = before.tcp_pos.dtype
        return reduce(or_, done).to(dtype) - reduce(or_, undone).to(dtype)


def arrival_speed(before: State, after: State) -> Tensor:
    """Return the Euclidean norm of the joint velocities, rad/s, at the step that completes a stage, else 0.

    The next policy takes over an arm in motion beside a table; after a fast arrival it often hits it.
    """
    return vector_norm(after.joint_vel, dim=-1).masked_fill(after.stage <= before.stage, 0.0)


def contact(before: State, after: State) -> Tensor:
    """Return 1 where a contact of robot and human begins."""
    return (after.touching & ~before.touching).to(after.tcp_pos.dtype)


def other_collision(before: State, after: State) -> Tensor:
    """Return 1 where the robot touches the workcell or itself."""
    return (after.table_collision | after.self_collision).to(after.tcp_pos.dtype)


def step(before: State, after: State) -> Tensor:
    """Return 1 at every control step (the paper's optional -0.1 a step)."""
    return torch.ones_like(after.tcp_pos[..., 0])


def overtime(before: State, after: State) -> Tensor:
    """Return 1 at every control step after the first LATE_STEPS.

    Policies do not observe the time, so the cost falls on states in which episodes dwell.
    """
    return (after.steps > LATE_STEPS).to(after.tcp_pos.dtype)


def return_shaping(before: State, after: State) -> Tensor:
    """Return -ln(d + 1) / 10, d the distance of the tool from its home, m: the released code's shaping."""
    return -torch.log1p(vector_norm(after.tcp_pos - after.tcp_home, dim=-1)) / 10.0


def standard(stages: tuple[Stage, ...]) -> dict[str, TransitionFunction]:
    """Return every term that can pay a subtask of these stages, by the name of its weight."""
    terms: dict[str, TransitionFunction] = {}
    if any(not stage.joint_space for stage in stages):
        terms["progress"] = Progress(stages, joint_space=False)
    if any(stage.joint_space for stage in stages):
        terms["home_progress"] = Progress(stages, joint_space=True)
        terms["return_shaping"] = return_shaping
    for bonus in dict.fromkeys(stage.bonus for stage in stages):
        terms[bonus] = Completion(tuple(index for index, stage in enumerate(stages) if stage.bonus == bonus))
    common = (arrival_speed, contact, other_collision, step, overtime)
    return {**terms, **{term.__name__: term for term in common}}
