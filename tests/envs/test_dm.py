"""Conformance of the dm_control front, for every task and human."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from dm_control.rl.control import Environment

import hrl_comfort
from hrl_comfort.humans import MOTIONS
from hrl_comfort.scene.camera import PicturesUnavailableError
from hrl_comfort.tasks import SUBTASKS

CASES = [(task, human) for task in sorted(SUBTASKS) for human in sorted(MOTIONS)]
EACH = sorted({(task, "mixture") for task in SUBTASKS} | {("pick_place", human) for human in MOTIONS})
"""Every task and every human, though not every pair of them."""


@pytest.fixture(scope="module")
def motion_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("motion") / "walk.csv"
    path.write_text("t,x,y,yaw\n0,0.7,-0.7,2.3\n2,0.5,-0.8,2.1\n", encoding="utf-8")
    return path


def loaded(task: str, human: str, motion_file: Path, seed: int = 0) -> Environment:
    choices = {"human.file": str(motion_file)} if human == "recorded" else {}
    return hrl_comfort.load(task, seed=seed, human=human, **choices)


@pytest.mark.parametrize(("task", "human"), CASES)
def test_environment_keeps_the_dm_env_contract(task: str, human: str, motion_file: Path) -> None:
    env = loaded(task, human, motion_file)
    spec, actions = env.observation_spec(), env.action_spec()
    rng = np.random.default_rng(0)
    step = env.reset()
    assert step.first() and step.reward is None and step.discount is None
    seen = []
    for _ in range(6):
        step = env.step(rng.uniform(actions.minimum, actions.maximum))
        assert list(step.observation) == list(spec)
        for name, value in step.observation.items():
            spec[name].validate(value)
            assert np.isfinite(value).all(), name
        assert np.isfinite(step.reward) and step.discount in (0.0, 1.0)
        seen.append(np.concatenate([np.ravel(v) for v in step.observation.values()]))
        if step.last():
            step = env.reset()
    assert np.ptp(seen, axis=0).max() > 0


@pytest.mark.parametrize(("task", "human"), EACH)
def test_the_same_seed_gives_the_same_episode(task: str, human: str, motion_file: Path) -> None:
    first, second = loaded(task, human, motion_file, 4), loaded(task, human, motion_file, 4)
    action = np.full(6, 0.3)
    first.reset()
    # A step after the last one of an episode starts the next.
    if not first.step(action).last():
        first.step(-action)
    # The second episode does not depend on the first.
    first.reset()
    second.reset()
    second.reset()
    for _ in range(3):
        a, b = first.step(action), second.step(action)
        for name in a.observation:
            np.testing.assert_array_equal(a.observation[name], b.observation[name])
        assert a.last() == b.last()


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("steps", [0, 1, 3])
def test_a_copy_goes_on_where_the_environment_is(copied: Callable[[Environment], Environment], steps: int) -> None:
    env = hrl_comfort.load("cycle", seed=3, comfort="conditioned")
    for _ in range(steps):
        env.step(np.full(6, 0.3))
    twin = copied(env)
    for action in np.random.default_rng(0).uniform(-1, 1, (40, 6)):  # into the next episodes
        step, other = env.step(action), twin.step(action)
        assert (step.step_type, step.reward) == (other.step_type, other.reward)
        for name in step.observation:
            np.testing.assert_array_equal(step.observation[name], other.observation[name])


def test_different_seeds_give_different_episodes(motion_file: Path) -> None:
    a = loaded("pick", "random_walk", motion_file, 0).reset().observation["human"]
    b = loaded("pick", "random_walk", motion_file, 1).reset().observation["human"]
    assert not np.array_equal(a, b)


def test_time_limit_is_truncation_with_discount_one() -> None:
    env = hrl_comfort.load("pick", human="none", **{"task.max_episode_steps": 10})
    env.reset()
    assert not env.step(np.zeros(6)).last()
    end = env.step(np.zeros(6))
    assert end.last() and end.discount == 1.0


def test_collision_terminates_with_discount_zero() -> None:
    env = hrl_comfort.load("pick", human="none")
    env.reset()
    down = np.array([0.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    for _ in range(100):
        step = env.step(down)
        if step.last():
            break
    assert step.last() and step.discount == 0.0


def test_a_viewer_can_read_and_reset_the_physics() -> None:
    # As dm_control.viewer does between frames: read the model, pause, restart the episode.
    env = hrl_comfort.load("cycle")
    env.reset()
    env.step(np.zeros(6))
    with env.physics.reset_context():
        pass
    assert env.physics.model.nmocap == 14  # limbs, places, marks of points, an object of each kind
    assert env.reset().first()


def test_without_a_display_a_picture_names_the_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr("glfw.init", lambda: False)
    with pytest.raises(PicturesUnavailableError, match="MUJOCO_GL=egl"):
        hrl_comfort.load("reach").physics.render()
