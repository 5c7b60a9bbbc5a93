"""Layouts of a cell that varies: within their ranges, free, of one split alone, and named by recorded starts."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch

from hrl_comfort.composition.compose import compose, compose_environment
from hrl_comfort.config import ConfigError, EnvConfig, EvaluateConfig
from hrl_comfort.evaluation.terminal_states import record_terminal_states
from hrl_comfort.humans import split_set
from hrl_comfort.scene.layout import reach
from hrl_comfort.scene.workcell import scene_of, tool_at
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.starts import recorded_starts
from hrl_comfort.sim.variation.layouts import SERVED_M, Layouts
from hrl_comfort.sim.variation.postures import Postures
from hrl_comfort.tasks import Start

ROWS = 12


def varied(*overrides: str, task: str = "pick") -> EnvConfig:
    return compose_environment("train", [f"task={task}", "cell=varied", "human=none", *overrides])


@cache
def begun(split: str = "train", task: str = "pick") -> Engine:
    entries = None if split == "train" else split_set(split, ROWS)
    engine = Engine(varied(task=task), ROWS, 0, entries)
    engine.reset()
    return engine


def test_layouts_keep_to_their_ranges_and_to_each_other() -> None:
    config, draw = varied(), begun().episodes.draw
    vary = config.cell.vary
    assert vary is not None
    distance = np.linalg.norm(draw.places[..., :2], axis=-1)
    assert (distance >= vary.distance_m[0]).all() and (distance <= vary.distance_m[1]).all()
    assert (draw.places[..., 2] >= vary.height_m[0]).all() and (draw.places[..., 2] <= vary.height_m[1]).all()
    ground = np.concatenate([draw.places, draw.obstacles], axis=1)[..., :2]
    apart = np.linalg.norm(ground[:, :, None] - ground[:, None], axis=-1) + 10 * np.eye(ground.shape[1])
    absent = np.linalg.norm(ground, axis=-1) > 10
    assert ((apart >= vary.apart_m) | (absent[:, :, None] & absent[:, None])).all()
    assert np.abs(draw.home - begun().scene.home).max() <= np.radians(vary.home_deg) + 1e-12
    shoulder, most = reach(config.robot.name)
    assert (np.linalg.norm(draw.kind_places - shoulder, axis=-1) < most).all()
    assert len(np.unique(draw.layout_id)) > ROWS / 2


def test_splits_have_no_layout_in_common() -> None:
    seen = {split: {each.tobytes() for each in begun(split).episodes.draw.places} for split in ("train", "test")}
    seen["validation"] = {each.tobytes() for each in begun("validation").episodes.draw.places}
    assert not (seen["train"] & seen["test"]) and not (seen["validation"] & (seen["train"] | seen["test"]))
    again = Engine(varied(), ROWS, 0, split_set("test", ROWS))
    again.reset()
    assert np.array_equal(again.episodes.draw.places, begun("test").episodes.draw.places)


def test_the_tool_begins_at_the_object_of_its_own_layout_and_ends_home_at_its_own_home() -> None:
    state = begun(task="place").episodes.state
    assert state is not None
    near = varied().task.precision.grasp_tolerance_m
    assert ((state.tcp_pos - state.target_object).norm(dim=-1) < near).all()
    assert torch.equal(state.joint_home, torch.from_numpy(begun(task="place").episodes.draw.home))
    home = begun().episodes.state
    assert home is not None and torch.allclose(home.joint_pos, home.joint_home)
    assert torch.allclose(home.tcp_pos, home.tcp_home, atol=1e-9)


def test_the_arm_can_serve_every_layout_clear_of_everything() -> None:
    config = varied()
    scene = scene_of(config)
    layouts, solver = Layouts(scene, config), Postures(scene.xml, scene.home, 0.9 * SERVED_M)
    for number in range(8):
        layout = layouts.numbered("train", number)
        solver.stand(layout.home, np.concatenate([layout.places, layout.obstacles]), scene.first_furniture)
        assert solver.turns()
        ends = [
            *zip(layout.arrives, layout.at_arrival, strict=True),
            *zip(layout.belongs, layout.at_place, strict=True),
        ]
        for goal, postures in ends:
            assert len(postures)
            for posture in postures:
                assert np.linalg.norm(tool_at(scene, posture) - goal) < config.task.precision.grasp_tolerance_m
                assert solver.free(posture) and solver.rises(posture)


def test_an_obstacle_that_is_not_there_is_far_away() -> None:
    obstacles = begun().episodes.draw.obstacles[..., 0]
    assert (obstacles > 10).any() and (obstacles < 1).any()


def test_places_are_where_the_layout_says_in_the_physics_too() -> None:
    engine = begun()
    scene, draw = engine.scene, engine.episodes.draw
    place = scene.furniture.index("place_pick") + scene.first_furniture
    controls = next(engine.episodes.controls(np.zeros((ROWS, 6)), lambda: engine.physics.state[:, 1:]))
    joints = len(scene.joints)
    assert np.array_equal(controls[:, 0, joints + 3 * place : joints + 3 * place + 3], draw.places[:, 0, :3])


def test_ranges_out_of_reach_are_refused_in_one_line() -> None:
    with pytest.raises(ConfigError, match=r"cell\.vary: none of \d+ layouts can be reached; bring cell\.vary"):
        Engine(varied("cell.vary.distance_m=[1.5,2.0]"), 1, 0)
    with pytest.raises(ConfigError, match=r"cell\.vary\.height_m=\[0\.4, 0\.1\] is not \[low, high\]"):
        varied("cell.vary.height_m=[0.4,0.1]")


def test_recorded_starts_bring_their_layout_and_are_refused_in_another_cell(tmp_path: Path) -> None:
    file, asked = tmp_path / "starts.npz", ("cell=varied", "human=none", "task.precision.grasp_tolerance_m=0.4")
    words = [
        "task=pick",
        *asked,
        "policy=expert",
        "episodes=12",
        f"terminal_states={file}",
        f"output={tmp_path / 'out'}",
    ]
    config = compose("evaluate", words)
    assert isinstance(config, EvaluateConfig)
    record_terminal_states(config)
    start = f"task.start={file}"
    engine = Engine(varied(*asked[2:], start, task="place"), ROWS, 0)
    state = engine.reset()
    banks = recorded_starts(varied(*asked[2:], start, task="place"), Start.AT_OBJECT, 6)
    assert banks is not None
    known = {int(row[-1]) for bank in banks for row in bank}
    assert {int(number) for number in engine.episodes.draw.layout_id[:, 0]} <= known
    assert ((state.tcp_pos - state.target_object).norm(dim=-1) < 0.4).all()
    anew = Engine(varied(*asked[2:], start, "task.resample_start_probability=1", task="place"), ROWS, 0)
    state = anew.reset()
    assert not {int(number) for number in anew.episodes.draw.layout_id[:, 0]} & known, "layouts of their own"
    assert ((state.tcp_pos - state.target_object).norm(dim=-1) < 0.4).all()
    with pytest.raises(ConfigError, match=r"was recorded in another cell or of another robot; record it anew"):
        Engine(varied(*asked[2:], start, "cell.vary.home_deg=5", task="place"), 1, 0)
