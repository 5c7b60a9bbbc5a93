"""Gymnasium fronts: conformance, and the same episodes as the other fronts."""

from __future__ import annotations

import copy
import os
import pickle
import shutil
import subprocess
import sys
from collections.abc import Callable
from typing import Any
from unittest.mock import MagicMock

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import hrl_comfort
from hrl_comfort import environment_of
from hrl_comfort.config import FIRST_SEED, SPLITS, VALIDATION_SEED, ConfigError
from hrl_comfort.envs.gymnasium import CellGym, CellVector
from hrl_comfort.envs.inputs import SEEDS, episode_seed, replayed
from hrl_comfort.gym import IDS, TaskEnv
from hrl_comfort.humans import split_set
from hrl_comfort.scene.camera import PicturesUnavailableError
from hrl_comfort.sim.engine import Engine
from tests.envs.pictures import drawn


@pytest.mark.parametrize("task", list(IDS))
@pytest.mark.filterwarnings("ignore:.*Box observation space")
def test_every_subtask_passes_gymnasiums_own_check(task: str) -> None:
    env = gymnasium.make(IDS[task])
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


def test_ids_are_named_after_the_subtasks() -> None:
    assert IDS["pick_place"] == "hrl_comfort/PickPlace-v0" and IDS["return"] == "hrl_comfort/Return-v0"


def test_a_seed_gives_the_episodes_of_the_dm_control_front() -> None:
    env, twin = gymnasium.make(IDS["pick"], human="arc"), hrl_comfort.load("pick", seed=3, human="arc")
    rng = np.random.default_rng(0)
    for seed in (3, None):  # the next reset starts the next episode
        observation, _ = env.reset(seed=seed)
        there = twin.reset()
        ended = False
        while not ended:
            assert observation == pytest.approx(np.concatenate(list(there.observation.values())), abs=1e-5)
            action = rng.uniform(-1, 1, 6)
            observation, reward, terminated, truncated, info = env.step(action.astype(np.float32))
            there = twin.step(action.astype(np.float32).astype(np.float64))
            ended = terminated or truncated
            assert reward == pytest.approx(there.reward, abs=1e-6) and ended == there.last()
        assert set(info) >= {"success", "contact", "steps", "human_distance"}


def test_a_row_of_the_batch_equals_the_single_cell_and_restarts_at_its_end() -> None:
    short = {"task.max_episode_steps": 40}
    cells = gymnasium.make_vec(IDS["pick"], num_envs=3, **short)
    lone = gymnasium.make(IDS["pick"], **short)
    observations, _ = cells.reset(seed=5)
    observation, _ = lone.reset(seed=5)
    rng, ends = np.random.default_rng(1), 0
    for _ in range(20):
        assert observations.shape == (3, *lone.observation_space.shape)
        assert observations[0] == pytest.approx(observation, abs=1e-6)
        actions = rng.uniform(-1, 1, (3, 6)).astype(np.float32)
        observations, rewards, terminated, truncated, infos = cells.step(actions)
        observation, reward, term, trunc, steps = lone.step(actions[0])
        assert (rewards[0], terminated[0], truncated[0]) == (pytest.approx(reward), term, trunc)
        if term or trunc:
            ends += 1
            assert infos["final_obs"].shape == (3,) and infos["final_obs"][0].dtype == np.float32
            assert infos["final_obs"][0] == pytest.approx(observation, abs=1e-6) and infos["_final_obs"][0]
            assert infos["final_info"]["steps"][0] == steps["steps"] and infos["_final_info"][0]
            observation, _ = lone.reset()
    assert ends
    cells.close()


def test_unseeded_environments_differ() -> None:
    first, second = (gymnasium.make(IDS["reach"]).reset()[0] for _ in range(2))
    assert (first != second).any()


def test_no_seed_of_a_client_draws_an_episode_of_a_split() -> None:
    # Stable-Baselines3 draws seeds of 32 bits; 850,000 and above are those of the splits.
    drawn = {episode_seed(seed) for seed in (VALIDATION_SEED, FIRST_SEED, 2**31, 2**32 - 1)}
    assert min(drawn) > max(last + most for _, last, most in SPLITS.values()) and max(drawn) < SEEDS
    env = gymnasium.make(IDS["reach"])
    observation, _ = env.reset(seed=FIRST_SEED)
    committed, _ = env.reset(options={"episode": 0, "split": "paper"})
    assert (observation != committed).any()


@pytest.mark.parametrize("seed", [-1, 1.5, 2**70])
def test_a_seed_that_is_not_one_is_refused(seed: Any) -> None:
    with pytest.raises(ConfigError, match=r"seed=.* must be a whole number from 0 to 4294967295"):
        episode_seed(seed)
    with pytest.raises((ConfigError, gymnasium.error.Error), match=r"[Ss]eed"):
        gymnasium.make(IDS["reach"]).reset(seed=seed)


def test_one_seed_determines_all_rows() -> None:
    with pytest.raises(ConfigError, match=r"seed=\[1, 2\] must be one number"):
        gymnasium.make_vec(IDS["reach"], num_envs=2).reset(seed=[1, 2])


@pytest.mark.parametrize("split", ["paper", "train", "validation"])
def test_options_replay_the_episodes_of_an_evaluation(split: str) -> None:
    config = environment_of("place", {"human": "arc"})
    engine = Engine(config, 4, 0, split_set(split, 4))
    wanted = engine.episodes.subtask.observe(engine.reset())
    cells = CellVector(config, 2)
    cells.reset(seed=1)
    observations, _ = cells.reset(options={"episode": 2, "split": split})
    assert observations == pytest.approx(wanted[2:].numpy(), abs=1e-6)
    assert cells.reset(options={"episode": [3, 0], "split": split})[0][1] == pytest.approx(wanted[0].numpy(), abs=1e-6)
    cell = CellGym(config)
    assert cell.reset(options={"episode": 3, "split": split})[0] == pytest.approx(wanted[3].numpy(), abs=1e-6)
    action = np.linspace(-1, 1, 6)
    theirs = engine.step(np.tile(action, (4, 1)))
    observation, reward, *_ = cell.step(action)
    assert observation == pytest.approx(engine.episodes.subtask.observe(theirs.state)[3].numpy(), abs=1e-6)
    assert reward == pytest.approx(float(theirs.reward[3]))


def test_a_replay_leaves_the_episodes_of_the_seed_as_they_are() -> None:
    plain, replaying = CellGym(environment_of("reach", {})), CellGym(environment_of("reach", {}))
    plain.reset(seed=2)
    replaying.reset(seed=2)
    replaying.reset(options={"episode": 5, "split": "validation"})
    assert (plain.reset()[0] == replaying.reset()[0]).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"episode": 3}, "splits are paper, train, validation"),
        ({"colour": "pink"}, "splits are paper, train, validation"),
        ({"episode": 3, "split": "test_set"}, "choose one of paper, train, validation"),
        ({"episode": 1000, "split": "paper"}, r"range \[0, 999\]"),
        ({"episode": 1.5, "split": "paper"}, "whole number"),
        ({"episode": [1, 2], "split": "paper"}, "one number, or 1"),
    ],
)
def test_other_options_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        replayed(options, 1)


def test_an_unknown_keyword_is_a_type_error_and_a_wrong_choice_a_config_error() -> None:
    for make in (gymnasium.make, gymnasium.make_vec):
        with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'"):
            make(IDS["pick"], frameskip=1)
        with pytest.raises(ConfigError, match="human"):
            make(IDS["pick"], human="nobody")
    with pytest.raises(ConfigError, match="render_mode='ansi' is not allowed"):
        TaskEnv("pick", render_mode="ansi")


@pytest.mark.parametrize("number", [0, -1, 10**9, 1.5])
def test_a_number_of_environments_that_is_not_one_is_refused(number: Any) -> None:
    with pytest.raises(ConfigError, match=f"num_envs={number}"):
        gymnasium.make_vec(IDS["pick"], num_envs=number)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_where_the_environment_is(copied: Callable[[Any], Any]) -> None:
    env, action = gymnasium.make(IDS["pick_place"]).unwrapped, np.full(6, 0.4, np.float32)
    with pytest.raises(gymnasium.error.ResetNeeded):
        copied(env).step(action)
    env.reset(seed=1)
    env.step(action)
    twin = copied(env)
    for _ in range(3):
        assert (env.step(action)[0] == twin.step(action)[0]).all()
    assert (env.reset()[0] == twin.reset()[0]).all()


def test_a_picture_shows_the_cell_as_it_is() -> None:
    env = gymnasium.make(IDS["pick"], render_mode="rgb_array")
    assert env.metadata["render_fps"] == 10
    assert gymnasium.make(IDS["pick"], **{"task.action_repeat": 10}).metadata["render_fps"] == 5
    env.reset(seed=0)
    before = drawn(env.render)
    assert before.shape == (360, 480, 3) and before.dtype == np.uint8 and np.ptp(before) > 100
    assert (env.render() == before).all()
    for _ in range(5):
        env.step(np.ones(6, np.float32))
    assert (env.render() != before).any()
    twin = gymnasium.make_vec(IDS["pick"], num_envs=2, render_mode="rgb_array")
    twin.reset(seed=0)
    first, second = twin.render()
    assert (first == before).all() and (second != before).any()
    for each in (env, twin):
        each.close()
    assert gymnasium.make(IDS["pick"]).unwrapped.render_mode is None


def test_a_list_of_pictures_is_collected() -> None:
    env = gymnasium.make(IDS["reach"], render_mode="rgb_array_list")
    drawn(env.reset)
    env.step(np.zeros(6, np.float32))
    assert len(env.render()) == 2
    env.close()


def test_without_a_display_the_window_gets_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("glfw.init", lambda: False)
    env = gymnasium.make(IDS["reach"], render_mode="human")
    with pytest.raises(PicturesUnavailableError, match=r"no display.*rgb_array"):
        env.reset()
    with pytest.raises(ConfigError, match="one cell"):
        gymnasium.make_vec(IDS["reach"], num_envs=2, render_mode="human")


def test_the_window_follows_the_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    window = MagicMock()
    monkeypatch.setattr("glfw.init", lambda: True)
    monkeypatch.setattr("mujoco.viewer.launch_passive", window)
    env = gymnasium.make(IDS["reach"], render_mode="human")
    env.reset()
    env.step(np.zeros(6, np.float32))
    assert window.call_count == 1 and window.return_value.sync.call_count == 2 and env.render() is None
    env.close()
    window.return_value.close.assert_called_once()


WINDOW = """
import gymnasium, numpy, hrl_comfort.gym
env = gymnasium.make("hrl_comfort/Reach-v0", render_mode="human")
env.reset(seed=0)
env.step(numpy.zeros(6, numpy.float32))
print(env.unwrapped._cells._view._window.is_running())
{end}
"""


@pytest.mark.skipif(shutil.which("xvfb-run") is None, reason="xvfb is not installed")
@pytest.mark.parametrize("end", ["env.close()", ""])
def test_a_window_opens_on_a_display_and_ends_with_the_process(end: str) -> None:
    words = ["xvfb-run", "-a", sys.executable, "-c", WINDOW.format(end=end)]
    env = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    done = subprocess.run(words, capture_output=True, text=True, env=env, timeout=300)
    assert (done.returncode, done.stdout) == (0, "True\n"), done.stderr
