"""Cells for a hand that vary: places lie elsewhere on their table, and episodes begin and go on in their layout."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch

from hrl_comfort.composition.compose import compose, compose_environment
from hrl_comfort.config import EnvConfig, EvaluateConfig
from hrl_comfort.evaluation.terminal_states import record_terminal_states
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.variation.layouts import inside
from tests.hand.campaign import decisions

VARIED = ("cell=grasp_varied", "human=none", "task.object_jitter_m=0.07")
ROWS = 8


def varied(*words: str) -> EnvConfig:
    return compose_environment("train", [*VARIED, *words])


@cache
def begun(*words: str) -> Engine:
    engine = Engine(varied(*words), ROWS, 0)
    engine.reset()
    return engine


def test_places_lie_apart_on_their_table_which_stays_and_objects_go_both_ways() -> None:
    engine = begun("task=cycle")
    vary, draw = engine.episodes.config.cell.vary, engine.episodes.draw
    bearing = np.arctan2(draw.places[..., 1], draw.places[..., 0])
    assert (bearing[:, 0] > bearing[:, 1]).any() and (bearing[:, 0] < bearing[:, 1]).any()
    assert (np.linalg.norm(draw.places[:, 0, :2] - draw.places[:, 1, :2], axis=-1) >= vary.apart_m).all()
    assert (draw.obstacles == engine.scene.layout[-1]).all()
    assert all(inside(top, tops[-1]) for tops in draw.tops for top in tops[:-1])
    assert ((draw.places[..., 2] >= vary.height_m[0]) & (draw.places[..., 2] <= vary.height_m[1])).all()
    assert len(np.unique(draw.layout_id)) > ROWS / 2


@pytest.mark.parametrize("words", [("task=place",), ("task=pick", "task.start=pregrasp"), ("task=return",)])
def test_a_hand_begins_at_the_object_of_its_layout(words: tuple[str, ...]) -> None:
    engine = begun(*words)
    state, where = engine.episodes.state, 1 if words == ("task=return",) else 0
    assert state is not None
    away = (state.objects[:, 0] - torch.from_numpy(engine.episodes.draw.places[:, where, :3])).numpy()
    assert ((state.tcp_pos - state.target_object).norm(dim=-1) < 0.2).all()
    if words == ("task=place",):
        assert state.pads.all() and (away[:, 2] > 0.1).all()
    else:
        assert (np.abs(away[:, :2]) < 0.11).all() and (away[:, 2] < 0.05).all() and not state.pads.any()


def test_the_expert_carries_objects_in_every_layout() -> None:
    done = sum(result.success & torch.from_numpy(going) for going, result in decisions(varied("task=cycle"), 4))
    assert isinstance(done, torch.Tensor) and done.bool().all()


def test_recorded_starts_bring_their_layout(tmp_path: Path) -> None:
    file = tmp_path / "picked.npz"
    words = ["task=pick", "task.start=pregrasp", "policy=expert", "episodes=8", f"terminal_states={file}"]
    config = compose("evaluate", [*VARIED, *words, f"output={tmp_path}"])
    assert isinstance(config, EvaluateConfig)
    record_terminal_states(config)
    engine = Engine(varied("task=place", f"task.start={file}"), ROWS, 0)
    state = engine.reset()
    with np.load(file) as banks:
        known = {int(row[-1]) for kind in engine.scene.cell.kinds for row in banks[kind]}
    assert {int(number) for number in engine.episodes.draw.layout_id[:, 0]} <= known
    assert state.pads.all() and state.carried.all()
    on = engine.episodes.draw.places[:, 0, 2] + state.kind_sizes[:, 0, 2].numpy()
    assert np.abs(state.ground[:, 0].numpy() - on).max() < 0.2


def test_episodes_go_on_exactly_from_a_saved_state() -> None:
    engine, other = (Engine(varied("task=pick", "task.max_episode_steps=20"), 2, 0) for _ in range(2))
    engine.reset()
    other.reset()

    def step(one: Engine, action: np.ndarray) -> torch.Tensor:
        result = one.step(action)
        return torch.cat([result.state.joint_pos, one.reset(np.flatnonzero(result.done.numpy())).layout.flatten(1)], 1)

    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (12, 2, 7))
    for action in actions[:3]:
        step(engine, action)
    other.load_state_dict(engine.state_dict())
    went = [(step(engine, action), step(other, action)) for action in actions[3:]]
    assert all(torch.equal(mine, its) for mine, its in went)
    assert not torch.equal(went[0][0][:, 6:], went[-1][0][:, 6:])
