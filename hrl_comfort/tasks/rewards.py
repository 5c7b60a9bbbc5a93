"""Reward terms: named, pure, unweighted; weights are configuration (`conf/reward`).

A term maps the states before and after one control step to (N,). The reward of a decision is the sum,
over its control steps, of the weighted terms.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.linalg import vector_norm

from hrl_comfort.tasks.state import State
from hrl_comfort.tasks.subtask import Change, Stage

HOMEWARD = "return"
LATE_STEPS = 150
BONUS_NAMES = {"pick": "pick", "place": "place", "return": "home", "reach": "reach"}
"""Stage name to the weight that its completion is paid with (the paper: +50, +100, +150)."""


def progress(stages: tuple[Stage, ...], homeward: bool) -> Change:
    """Return the decrease, over the step, of the distance of the stage in force.

    Metres for stages that move the tool; rad, summed over joints, for the `return` stage (`homeward`).
    """

    def term(before: State, after: State) -> Tensor:
        gain = torch.zeros_like(before.tcp_pos[:, 0])
        for index, stage in enumerate(stages):
            if (stage.name == HOMEWARD) is homeward:
                shrunk = stage.distance(before) - stage.distance(after)
                gain = gain + torch.where(before.stage == index, shrunk, 0.0)
        return gain

    return term


def completion(index: int) -> Change:
    """Return 1 at the step that completes stage `index`, else 0."""

    def term(before: State, after: State) -> Tensor:
        return ((before.stage == index) & (after.stage == index + 1)).to(before.tcp_pos.dtype)

    return term


def total(terms: list[Change]) -> Change:
    """Return the sum of terms that share one weight."""
    return lambda before, after: torch.stack([term(before, after) for term in terms]).sum(0)


def arrival_speed(before: State, after: State) -> Tensor:
    """Return the Euclidean norm of the joint velocities, rad/s, at the step that completes a stage, else 0.

    Whoever acts next takes over the arm in motion, beside a table: fast arrivals end in it.
    """
    return torch.where(after.stage > before.stage, vector_norm(after.joint_vel, dim=-1), 0.0)


def human_collision(before: State, after: State) -> Tensor:
    """1 where the robot touches the human."""
    return after.human_collision.to(after.tcp_pos.dtype)


def other_collision(before: State, after: State) -> Tensor:
    """1 where the robot touches the workcell or itself."""
    return (after.table_collision | after.self_collision).to(after.tcp_pos.dtype)


def step(before: State, after: State) -> Tensor:
    """1 at every control step (the paper's optional -0.1 a step)."""
    return torch.ones_like(after.tcp_pos[:, 0])


def overtime(before: State, after: State) -> Tensor:
    """1 at every control step after the first LATE_STEPS, 3 s: nobody on the way to a goal is so long.

    Policies do not see the time; so what it costs falls on where episodes dwell, not on the way round.
    """
    return (after.steps > LATE_STEPS).to(after.tcp_pos.dtype)


def return_shaping(before: State, after: State) -> Tensor:
    """-ln(d + 1) / 10, d the distance in metres of the tool from its home: the released code's shaping."""
    return -torch.log1p(vector_norm(after.tcp_pos - after.tcp_home, dim=-1)) / 10.0


def standard(stages: tuple[Stage, ...]) -> dict[str, Change]:
    """Return every term that can pay a subtask of these stages, by the name of its weight."""
    names = [stage.name for stage in stages]
    terms: dict[str, Change] = {}
    if any(name != HOMEWARD for name in names):
        terms["progress"] = progress(stages, homeward=False)
    if HOMEWARD in names:
        terms["home_progress"] = progress(stages, homeward=True)
        terms["return_shaping"] = return_shaping
    for name in dict.fromkeys(names):
        bonuses = [completion(index) for index, other in enumerate(names) if other == name]
        terms[BONUS_NAMES[name]] = bonuses[0] if len(bonuses) == 1 else total(bonuses)
    terms["arrival_speed"] = arrival_speed
    terms["human_collision"] = human_collision
    terms["other_collision"] = other_collision
    terms["step"] = step
    terms["overtime"] = overtime
    return terms
