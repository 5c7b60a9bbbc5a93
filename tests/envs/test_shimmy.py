"""Shimmy makes a Gymnasium environment of the dm_control front."""

from __future__ import annotations

import numpy as np
from gymnasium.wrappers import FlattenObservation
from shimmy import DmControlCompatibilityV0

import hrl_comfort
from tests.envs.pictures import drawn


def test_shimmy_seeds_steps_and_flattens() -> None:
    env = FlattenObservation(DmControlCompatibilityV0(hrl_comfort.load("pick")))
    first, _ = env.reset(seed=1)
    assert (env.reset(seed=2)[0] != first).any() and (env.reset(seed=1)[0] == first).all()
    assert env.action_space.shape == (6,)
    env.action_space.seed(0)
    ended = False
    while not ended:
        observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        ended = terminated or truncated
        assert observation.shape == env.observation_space.shape and np.isfinite(reward)


def test_shimmy_draws() -> None:
    env = DmControlCompatibilityV0(hrl_comfort.load("reach"), "rgb_array", {"camera_id": "side"})
    env.reset()
    assert np.ptp(drawn(env.render)) > 100
