"""Starts of episodes with a hand: with what a policy left in the hand, or on the way from the object to home."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from hrl_comfort.composition.compose import compose, compose_environment
from hrl_comfort.config import ConfigError, EnvConfig, EvaluateConfig
from hrl_comfort.evaluation.terminal_states import record_terminal_states
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.variation.grasps import AHEAD_RAD, FACING_RAD

SLACK_RAD = 0.3
"""By how much inverse kinematics may leave what a start is searched in."""
ALONE = ("cell=grasp", "human=none", "task.object_jitter_m=0.07")


def cell(*words: str) -> EnvConfig:
    return compose_environment("train", [*ALONE, *words])


def recorded(task: str, file: Path, *words: str) -> dict[str, np.ndarray]:
    asked = [
        *ALONE, f"task={task}", "policy=expert", "episodes=6", f"terminal_states={file}", *words,
        f"output={file.parent}",
    ]  # fmt: skip
    config = compose("evaluate", asked)
    assert isinstance(config, EvaluateConfig)
    record_terminal_states(config)
    with np.load(file) as banks:
        return dict(banks)


def test_what_a_pick_leaves_in_the_hand_is_held_when_the_place_begins(tmp_path: Path) -> None:
    file = tmp_path / "picked.npz"
    banks = recorded("pick", file)
    config = cell("task=place", f"task.start={file}")
    engine = Engine(config, 6, 0)
    state = engine.reset()
    model = engine.scene.model
    assert state.pads.all() and state.carried.all()
    assert (state.grip_target == 1).all() and ((state.grip > 0.05) & (state.grip < 0.95)).all()
    for row in range(6):
        kind = config.cell.kinds[int(state.kinds[row, 0])]
        assert state.joint_pos[row].numpy() == pytest.approx(banks[kind][:, :6][_nearest(banks[kind], state, row)])
        at = model.joint(f"object_1_{kind}").qposadr[0]
        body = banks[kind][_nearest(banks[kind], state, row), 18 : 18 + model.nq]
        assert state.objects[row, 0].numpy() == pytest.approx(body[at : at + 3], abs=1e-6)
    hold = np.zeros((6, 7))
    hold[:, 6] = 1.0
    for _ in range(10):
        state = engine.step(hold).state
    assert state.pads.all() and not state.drops.any()


def _nearest(bank: np.ndarray, state, row: int) -> int:
    return int(np.abs(bank[:, :6] - state.joint_pos[row].numpy()).max(axis=1).argmin())


def test_a_return_begins_with_the_object_where_a_place_left_it(tmp_path: Path) -> None:
    file = tmp_path / "placed.npz"
    recorded("place", file, "task.precision.place_tolerance_m=0.03")
    state = Engine(cell("task=return", f"task.start={file}"), 4, 0).reset()
    assert not state.pads.any() and (state.grip_target == 0).all()
    assert ((state.objects - state.object_places).norm(dim=-1) < 0.03).all()


@pytest.mark.parametrize("task", ["task=place", "task=return"])
@pytest.mark.parametrize("varied", [[], ["cell=grasp_varied", "cell.vary.layouts=4"]])
def test_an_arm_begins_as_it_gets_there_from_home_and_not_bent_over_backwards(task: str, varied: list[str]) -> None:
    engine = Engine(cell(task, *varied), 24, 0)
    state, home = engine.reset(), torch.from_numpy(engine.scene.home)
    assert ((state.joint_pos - home)[:, 1:].abs() < AHEAD_RAD + SLACK_RAD).all()
    aside = torch.atan2(state.tcp_pos[:, 1], state.tcp_pos[:, 0]) - state.joint_pos[:, 0]
    assert (aside.cos() > math.cos(FACING_RAD + SLACK_RAD)).all()


def test_recorded_starts_of_another_hand_or_cell_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "picked.npz"
    recorded("pick", file)
    with pytest.raises(ConfigError, match="recorded in another cell or of another robot"):
        Engine(cell("task=place", f"task.start={file}", "gripper=robotiq_2f85"), 1, 0)
    with pytest.raises(ConfigError, match="recorded in another cell or of another robot"):
        Engine(cell("task=place", f"task.start={file}", "cell.objects.cube.mass_kg=0.1"), 1, 0)
    with pytest.raises(ConfigError, match=r"it must be \(M, 18\) or \(M, 21\)"):
        Engine(cell("task=place", f"task.start={file}", "gripper=none"), 1, 0)


def test_a_pick_begins_up_to_the_reach_of_the_curriculum_on_the_way_home() -> None:
    engine = Engine(cell("task=pick"), 16, 0)
    home = torch.from_numpy(engine.scene.home)

    def ways(reach: float) -> np.ndarray:
        engine.episodes.sampler.reach = reach
        away = (engine.reset().joint_pos - home).abs().amax(dim=-1).numpy()
        draw = engine.episodes.draw
        before = np.abs(draw.before - engine.scene.home).max(axis=1)
        return 1 - away / np.where(np.isnan(before), np.inf, before)

    assert ways(0.0) == pytest.approx(np.zeros(16), abs=1e-9)
    part = ways(0.5)
    assert part.min() >= -1e-9 and 0.2 < part.max() <= 0.5 + 1e-9
    assert (ways(4.0) == 1).sum() > 4
    assert (ways(np.inf) == 1).all()
    saved = engine.state_dict()
    engine.episodes.sampler.reach = 0.0
    engine.load_state_dict(saved)
    assert engine.episodes.sampler.reach == np.inf


def test_a_pick_begins_in_front_of_the_object_where_the_configuration_says_so() -> None:
    state = Engine(cell("task=pick", "task.start=pregrasp"), 4, 0).reset()
    assert ((state.objects[:, 0] - state.tcp_pos).norm(dim=-1) < 0.2).all()
