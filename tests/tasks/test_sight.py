"""Sight does not depend on which way the cell is turned, and tells near people from far ones."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import torch
from torch import Tensor

from hrl_comfort.composition.compose import compose_environment
from hrl_comfort.policies.graph import inputs_of, state_of
from hrl_comfort.safety.geometry import segment_distance
from hrl_comfort.sim.engine import Engine
from hrl_comfort.tasks import State, Subtask
from hrl_comfort.tasks.observations.sight import FARTHEST_M, SURFACES, closest

WORLD = ("task=place", "cell=varied", "human=mixture", "safety=ssm", "robot.rating=collaborative")


@cache
def seen() -> tuple[Subtask, State]:
    engine = Engine(
        compose_environment("train", [*WORLD, "task.terminate_on=unsafe_contact", "task.observation=sight"]), 24, 0
    )
    engine.reset()
    for _ in range(3):
        engine.step(np.random.default_rng(0).uniform(-1, 1, (24, 6)))
    assert engine.episodes.state is not None
    return engine.episodes.subtask, engine.episodes.state


def turned(points: Tensor, angle: float) -> Tensor:
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = points[..., 0], points[..., 1]
    return torch.stack([cos * x - sin * y, sin * x + cos * y, *points[..., 2:].unbind(-1)], dim=-1)


def ends_turned(bodies: Tensor, angle: float) -> Tensor:
    ends = torch.cat([turned(bodies[..., :3], angle), turned(bodies[..., 3:6], angle)], dim=-1)
    return torch.cat([ends, bodies[..., 6:]], dim=-1)


def test_a_cell_that_is_turned_about_the_robot_looks_the_same() -> None:
    task, state = seen()
    angle = 1.1
    tops = torch.cat([turned(state.tops[..., :3], angle), state.tops[..., 3:5], state.tops[..., 5:] + angle], dim=-1)
    pan = torch.tensor([angle, 0, 0, 0, 0, 0], dtype=torch.float64)
    other = state.with_(
        joint_pos=state.joint_pos + pan,
        joint_home=state.joint_home + pan,
        tcp_pos=turned(state.tcp_pos, angle),
        kind_places=turned(state.kind_places, angle),
        objects=turned(state.objects, angle),
        tops=tops,
        arm_body=ends_turned(state.arm_body, angle),
        humans_body=ends_turned(state.humans_body, angle),
        humans_body_vel=torch.cat([turned(v, angle) for v in state.humans_body_vel.split(3, dim=-1)], dim=-1),
    )
    torch.testing.assert_close(task.observe(other), task.observe(state), rtol=0, atol=1e-9)


def test_nobody_is_seen_beside_nobody_and_a_touch_is_one() -> None:
    task, state = seen()
    people = task.observations["people"]
    away = state.humans_body.clone()
    away[..., [0, 3]] += 50.0
    assert not people(state.with_(humans_body=away)).any()
    hand = torch.cat([state.tcp_pos, state.tcp_pos, torch.full_like(state.tcp_pos[:, :1], 0.05)], dim=-1)
    beside = hand + torch.tensor([0.05, 0, 0, 0.05, 0, 0, 0], dtype=torch.float64)
    touched = people(state.with_(humans_body=beside[:, None], humans_body_vel=torch.zeros(24, 1, 6).double()))
    assert torch.allclose(touched[:, 0], torch.ones(24, dtype=torch.float64))


def test_who_comes_nearer_has_a_positive_speed() -> None:
    task, state = seen()
    off = state.tcp_pos + torch.tensor([0.4, 0.0, 0.0], dtype=torch.float64)
    body = torch.cat([off, off, torch.full_like(off[:, :1], 0.1)], dim=-1)[:, None]
    comes = torch.tensor([-0.8, 0, 0, -0.8, 0, 0], dtype=torch.float64).expand(24, 1, 6)
    people = task.observations["people"]
    nearer, farther = (people(state.with_(humans_body=body, humans_body_vel=way * comes))[:, 4] for way in (1, -1))
    assert (nearer > 0).all() and torch.allclose(nearer, -farther)


def test_distances_are_those_of_the_shields_geometry() -> None:
    _, state = seen()
    gap, _, _ = closest(state.arm_body, state.humans_body, state.humans_body_vel)
    arm, person = state.arm_body.numpy(), state.humans_body.numpy()
    ends = [np.moveaxis(each, -1, 0) for each in (arm[:, :, None, :3], arm[:, :, None, 3:6])]
    others = [np.moveaxis(each, -1, 0) for each in (person[:, None, :, :3], person[:, None, :, 3:6])]
    apart = segment_distance(*ends, *others) - arm[:, :, None, 6] - person[:, None, :, 6]
    assert np.abs(apart.min(axis=-1) - gap.numpy()).max() < 1e-9


@pytest.mark.parametrize("rows", [1, 5, 300])
def test_the_kernel_finds_what_defines_it(monkeypatch: pytest.MonkeyPatch, rows: int) -> None:
    random = torch.Generator().manual_seed(rows)
    bodies, others, moving = (
        torch.randn(rows, *shape, dtype=torch.float64, generator=random) for shape in ((13, 7), (8, 7), (8, 6))
    )
    bodies[:, :3, 3:6] = bodies[:, :3, :3]  # points
    others[:, 1, :6] = bodies[:, 1, :6]  # in the same place
    compiled = closest(bodies, others, moving)
    monkeypatch.setattr(torch.compiler, "is_compiling", lambda: True)
    for mine, defined in zip(compiled, closest(bodies, others, moving), strict=True):
        torch.testing.assert_close(mine, defined, rtol=0, atol=1e-12)


def test_sight_is_exported_for_any_number_of_cells() -> None:
    task, state = seen()
    inputs = inputs_of(task.observe, state)

    class Graph(torch.nn.Module):
        def forward(self, *values: Tensor) -> Tensor:
            return task.observe(state_of(inputs, values))

    rows, (two, five) = torch.export.Dim("rows", min=1), (state.rows(torch.arange(count)) for count in (2, 5))
    given = tuple(getattr(two, name) for name in inputs)
    program = torch.export.export(Graph(), given, dynamic_shapes=(tuple({0: rows} for _ in given),))
    made = program.module()(*(getattr(five, name) for name in inputs))
    torch.testing.assert_close(made, task.observe(five), rtol=0, atol=1e-12)


def test_the_nearest_surface_is_the_nearest_point_of_a_top() -> None:
    task, state = seen()
    surfaces = task.observations["surfaces"](state).reshape(24, SURFACES, 3)
    length = surfaces.norm(dim=-1)
    assert (length[:, 0] <= length[:, 1] + 1e-9).all() and (length[:, 1] <= length[:, 2] + 1e-9).all()
    over = state.with_(tcp_pos=state.tops[:, 0, :3] + torch.tensor([0.05, 0.02, 0.1], dtype=torch.float64))
    below = task.observations["surfaces"](over)[:, :3]
    assert torch.allclose(below[:, 2], torch.full((24,), -0.1, dtype=torch.float64))
    assert torch.allclose(below[:, :2], torch.zeros(24, 2, dtype=torch.float64), atol=1e-9)
    alone = task.observations["surfaces"](state.with_(tops=state.tops[:, :1]))
    assert (alone[:, 3:] == FARTHEST_M).all()


def test_clearance_is_one_at_a_touch_points_there_and_ends_where_nothing_is_near() -> None:
    task, state = seen()
    top = state.tops[:1, :1].expand(24, 1, -1).clone()
    top[..., 3:] = torch.tensor([0.08, 0.08, 0.0])
    above = top[..., :3] + torch.tensor([0.0, 0.0, 0.05])
    beside = top[..., :3] + torch.tensor([0.08 + 0.2, 0.0, -0.3])
    away = top[..., :3] + torch.tensor([0.0, 0.0, 0.5])
    ends = torch.cat([above, beside, away], dim=1)
    arm = torch.cat([ends, ends, torch.full_like(ends[..., :1], 0.05)], dim=-1)
    near = task.observations["clearances"](state.with_(tops=top, arm_body=arm)).reshape(24, 3, 3)
    down = torch.tensor([0.0, 0.0, -1.0], dtype=near.dtype).expand(24, 3)
    torch.testing.assert_close(near[:, 0], down)
    torch.testing.assert_close(near[:, 1].norm(dim=-1), torch.full((24,), 0.5, dtype=near.dtype))
    assert (near[:, 1, 2].abs() < 1e-6).all() and not near[:, 2].any()


@pytest.mark.parametrize("below", [-1e-9, 0.0, 0.3])
def test_at_a_top_and_below_it_the_way_out_is_up(below: float) -> None:
    task, state = seen()
    top = torch.zeros(24, 1, state.tops.shape[-1], dtype=state.tops.dtype)
    top[..., 3:5] = 0.5
    end = torch.tensor([0.0, 0.0, -below], dtype=top.dtype).expand(24, 1, 3)
    arm = torch.cat([end, end, torch.full_like(end[..., :1], 0.05)], dim=-1)
    near = task.observations["clearances"](state.with_(tops=top, arm_body=arm)).reshape(24, 3)
    up = torch.tensor([0.0, 0.0, 1.0], dtype=near.dtype).expand(24, 3)
    torch.testing.assert_close(near / near.norm(dim=-1, keepdim=True), up)
