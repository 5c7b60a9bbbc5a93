"""Gymnasium fronts: conformance, and the same episodes as the other fronts."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import hrl_comfort
from hrl_comfort.config import FIRST_SEED, ConfigError
from hrl_comfort.gym import IDS


@pytest.mark.parametrize("task", list(IDS))
@pytest.mark.filterwarnings("ignore:.*(Box observation space|render)")
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
        assert set(info) >= {"success", "human_collision", "steps", "human_distance"}


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


def test_seeds_of_the_evaluation_set_are_refused() -> None:
    with pytest.raises(ConfigError, match=f"seed={FIRST_SEED} must be below"):
        gymnasium.make(IDS["reach"]).reset(seed=FIRST_SEED)
    with pytest.raises(ConfigError, match=r"seed=\[1, 2\] must be one number"):
        gymnasium.make_vec(IDS["reach"], num_envs=2).reset(seed=[1, 2])


def test_a_choice_that_is_not_there_gets_the_command_lines_error() -> None:
    with pytest.raises(ConfigError, match="human"):
        gymnasium.make(IDS["pick"], human="nobody")
