"""Objects of another mass, friction and size than the cell's: drawn once an episode, and everything follows them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from hrl_comfort.composition.compose import compose, compose_environment
from hrl_comfort.config import ConfigError, EnvConfig, EvaluateConfig
from hrl_comfort.envs.dm import make_environment
from hrl_comfort.evaluation.terminal_states import record_terminal_states
from hrl_comfort.scene.workcell import scene_of
from hrl_comfort.sim.engine import Engine
from tests.hand.campaign import decisions

ALONE = ("cell=grasp", "human=none", "task.object_jitter_m=0.07")
OBJECTS = "randomise=objects"
RANGES = np.array([[0.5, 2.0], [0.7, 1.3], [0.8, 1.2]])[..., None]
"""Of mass, friction and size in OBJECTS."""


def cell(*words: str) -> EnvConfig:
    return compose_environment("train", [*ALONE, *words])


def actions(count: int, rows: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-0.3, 1.0, (count, rows, 7))


def test_each_episode_draws_masses_frictions_and_sizes_within_their_ranges() -> None:
    engine = Engine(cell("task=pick", OBJECTS), 6, 0)
    engine.reset()
    first = engine.episodes.draw.factors.copy()
    assert (first >= RANGES[:, 0]).all() and (first <= RANGES[:, 1]).all()
    assert np.unique(first).size == first.size
    engine.reset()
    assert not np.isin(engine.episodes.draw.factors, first).any()


def test_the_physics_has_the_objects_that_were_drawn() -> None:
    engine = Engine(cell("task=pick", OBJECTS), 2, 0)
    engine.reset()
    nominal = engine.scene.model
    for row, model in enumerate(engine.physics.models):  # type: ignore[attr-defined]
        for kind, name in enumerate(engine.scene.loose):
            mass, friction, size = engine.episodes.draw.factors[row, :, kind]
            body, geom = nominal.body(name).id, nominal.geom(name).id
            assert model.body_mass[body] == pytest.approx(mass * nominal.body_mass[body])
            inertia = mass * size**2 * nominal.body_inertia[body]
            assert model.body_inertia[body] == pytest.approx(inertia)
            assert model.geom_friction[geom, 0] == pytest.approx(friction * nominal.geom_friction[geom, 0])
            assert model.geom_friction[geom, 1:] == pytest.approx(nominal.geom_friction[geom, 1:])
            assert model.geom_size[geom] == pytest.approx(size * nominal.geom_size[geom])
        arm = [body for body in range(nominal.nbody) if nominal.body(body).name not in engine.scene.loose]
        assert (model.body_mass[arm] == nominal.body_mass[arm]).all()


@pytest.mark.parametrize("size", [0.8, 1.2])
def test_objects_lie_and_belong_where_their_size_says(size: float) -> None:
    config = cell("task=pick", f"randomise.object_size=[{size},{size}]")
    engine = Engine(config, 4, 0)
    state = engine.reset()
    half = size * torch.tensor([each.half_m for each in config.cell.objects.values()], dtype=torch.float64)
    assert torch.allclose(state.kind_sizes, half.expand(4, -1, -1))
    lies = 0.01 + half[state.kinds[:, 0], 2]
    assert torch.allclose(state.objects[:, 0, 2], lies) and torch.allclose(state.target_place[:, 2], lies)
    rest = np.zeros((4, 7))
    rest[:, 6] = -1.0
    for _ in range(5):
        state = engine.step(rest).state
    assert torch.allclose(state.objects[:, 0, 2], lies, atol=5e-4), "nothing sinks in or drops"


def test_other_draws_of_an_episode_stay_and_objects_of_the_cell_are_the_cell_s_to_the_bit() -> None:
    plain, same, other = (
        Engine(cell("task=pick", *words), 3, 0) for words in ((), ("randomise.object_size=[1.0,1.0]",), (OBJECTS,))
    )
    first, second, third = (engine.reset() for engine in (plain, same, other))
    for action in actions(3, 3):
        assert torch.equal(first.objects, second.objects) and torch.equal(first.joint_pos, second.joint_pos)
        first, second = plain.step(action).state, same.step(action).state
    for name in ("kinds", "target", "joint_home"):
        assert torch.equal(getattr(first, name), getattr(third, name))
    assert (plain.episodes.draw.turns == other.episodes.draw.turns).all()
    assert (plain.episodes.draw.arrivals[..., :2] == other.episodes.draw.arrivals[..., :2]).all()


def test_an_episode_does_not_depend_on_its_batch() -> None:
    alone, beside = Engine(cell("task=place", OBJECTS), 1, 0), Engine(cell("task=place", OBJECTS), 16, 0)
    assert torch.equal(alone.reset().objects[0], beside.reset().objects[0])
    for action in actions(4, 16):
        one, many = alone.step(action[:1]).state, beside.step(action).state
        for name in ("joint_pos", "objects", "objects_quat", "grip", "pads", "kind_sizes"):
            assert torch.equal(getattr(one, name)[0], getattr(many, name)[0])


def test_a_loaded_engine_goes_on_bit_for_bit_into_the_next_episodes() -> None:
    asked = cell("task=place", OBJECTS)
    engine, other = Engine(asked, 3, 0), Engine(asked, 3, 0)
    engine.reset()
    steps = actions(8, 3)
    for action in steps[:3]:
        engine.step(action)
    other.load_state_dict(engine.state_dict())
    for index, action in enumerate(steps[3:]):
        if index == 2:
            engine.reset(np.array([1]))
            other.reset(np.array([1]))
        mine, its = engine.step(action).state, other.step(action).state
        for name in ("joint_pos", "objects", "pads", "kind_sizes"):
            assert torch.equal(getattr(mine, name), getattr(its, name))


def test_dm_control_and_the_batch_run_the_same_episodes() -> None:
    config = cell("task=place", OBJECTS)
    engine, env = Engine(config, 1, 3), make_environment(config, 3)
    for _ in range(2):
        engine.reset()
        env.reset()
        for action in actions(3, 1):
            batch = engine.step(action).state
            env.step(action[0])
            for name in ("joint_pos", "objects", "grip", "pads"):
                assert torch.equal(getattr(batch, name), getattr(env.task.episodes.state, name))


@pytest.mark.parametrize("gripper", ["two_finger", "robotiq_2f85"])
def test_the_expert_picks_and_places_whatever_is_drawn(gripper: str) -> None:
    found = np.zeros(8, dtype=bool)
    for going, result in decisions(cell("task=cycle", OBJECTS, f"gripper={gripper}"), 8):
        found |= result.success.numpy() & going
    assert found.all()


@pytest.mark.parametrize("size", [0.8, 1.2])
@pytest.mark.parametrize("gripper", ["two_finger", "robotiq_2f85"])
def test_a_hand_begins_closed_on_an_object_of_any_size(gripper: str, size: float) -> None:
    engine = Engine(cell("task=place", f"gripper={gripper}", f"randomise.object_size=[{size},{size}]"), 4, 0)
    assert engine.reset().pads.all()
    hold = np.zeros((4, 7))
    hold[:, 6] = 1.0
    for _ in range(5):
        state = engine.step(hold).state
    assert state.pads.all() and not state.drops.any()


def test_the_guard_covers_the_largest_object() -> None:
    half = (0.02, 0.12, 0.02)
    words = ("~cell.objects.ball", f"cell.objects.cube.size_m={list(half)}".replace(" ", ""))
    guards = []
    for largest in (1.0, 1.2):
        model = scene_of(cell("task=pick", *words, f"randomise.object_size=[1,{largest}]")).model
        guards.append(model.geom_size[model.geom("robot/guard").id, 0])
    assert guards[0] < 1.2 * np.linalg.norm(half) < guards[1]


def test_a_recorded_start_brings_the_sizes_with_which_it_was_recorded(tmp_path: Path) -> None:
    file = tmp_path / "picked.npz"
    words = ["task=pick", OBJECTS, "policy=expert", "episodes=6", f"terminal_states={file}", f"output={tmp_path}"]
    config = compose("evaluate", [*ALONE, *words])
    assert isinstance(config, EvaluateConfig)
    record_terminal_states(config)
    engine = Engine(cell("task=place", OBJECTS, f"task.start={file}"), 6, 0)
    state = engine.reset()
    assert state.pads.all() and state.carried.all()
    with np.load(file) as banks:
        for row in range(6):
            bank = banks[engine.episodes.config.cell.kinds[int(state.kinds[row, 0])]]
            start = bank[np.abs(bank[:, :6] - state.joint_pos[row].numpy()).max(axis=1).argmin()]
            assert engine.episodes.draw.factors[row, 2] == pytest.approx(start[-2:])
    with pytest.raises(ConfigError, match=r"sizes are not in randomise\.object_size=\[1.19, 1.2\]"):
        Engine(cell("task=place", OBJECTS, f"task.start={file}", "randomise.object_size=[1.19,1.2]"), 1, 0)
    with pytest.raises(ConfigError, match=r"it must be \(M, "):
        Engine(cell("task=place", f"task.start={file}"), 1, 0)


def test_factors_that_do_not_go_are_refused_in_one_line() -> None:
    with pytest.raises(ConfigError, match="a hand holds; choose gripper=two_finger"):
        Engine(compose_environment("train", ["cell=paper", OBJECTS]), 1, 0)
    with pytest.raises(ConfigError, match=r"\[1.2, 0.8\] is not \[low, high\]"):
        cell("randomise.object_size=[1.2,0.8]")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("gripper=robotiq_2f85", "randomise.object_size=[1,1.5]"), "0.09 m wide; for robotiq_2f85 give at most 1.25"),
        (("cell=tray", "task=place_fine", "randomise.object_size=[1,1.2]"), "slot is 0.045 m wide; give at most 1.1"),
    ],
)
def test_sizes_that_do_not_fit_hand_or_slot_are_refused(words: tuple[str, ...], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        Engine(cell(*words), 1, 0)
