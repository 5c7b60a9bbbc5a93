"""An action that is not one is refused by every front, and so is a step without an episode."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict

import hrl_comfort
from hrl_comfort import environment_of
from hrl_comfort.envs.cells import Cells
from hrl_comfort.envs.gymnasium import CellGym, CellVector
from hrl_comfort.envs.torchrl import CellEnv
from hrl_comfort.sb3 import CellVecEnv

CONFIG = environment_of("reach", {"human": "none"})
BAD = [None, 0.5, np.nan, np.full(6, np.nan), [0, 0, np.inf, 0, 0, 0], np.zeros(5), np.zeros((2, 6)), "up"]


def dm() -> Callable[[Any], Any]:
    env = hrl_comfort.load("reach", human="none")
    env.reset()
    return env.step


def one() -> Callable[[Any], Any]:
    env = CellGym(CONFIG)
    env.reset()
    return env.step


def vector() -> Callable[[Any], Any]:
    env = CellVector(CONFIG, 3)
    env.reset()
    return env.step


def stable_baselines3() -> Callable[[Any], Any]:
    env = CellVecEnv(Cells(CONFIG, 3))
    env.reset()
    return env.step


@pytest.mark.parametrize("front", [dm, one, vector, stable_baselines3])
def test_an_action_that_is_not_one_is_refused(front: Callable[[], Callable[[Any], Any]]) -> None:
    step = front()
    for action in BAD:
        with pytest.raises(ValueError, match=r"action=.* must be \((3, )?6,?\) finite numbers") as error:
            step(action)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("action", [torch.full((2, 6), torch.nan), torch.zeros(2, 5), torch.zeros(2)])
def test_torchrl_refuses_it_too(action: torch.Tensor) -> None:
    env = CellEnv(CONFIG, 2, 0)
    env.reset()
    with pytest.raises(ValueError, match=r"must be \(2, 6\) finite numbers"):
        env.step(TensorDict({"action": action}, [2]))


def test_a_step_without_an_episode_is_refused() -> None:
    with pytest.raises(RuntimeError, match="call reset before step"):
        CellEnv(CONFIG, 2, 0).step(TensorDict({"action": torch.zeros(2, 6)}, [2]))
    with pytest.raises(RuntimeError, match="call reset before step"):
        CellVecEnv(Cells(CONFIG, 2)).step(np.zeros((2, 6)))
    for env in (CellGym(CONFIG), CellVector(CONFIG, 1)):
        for call in (lambda env=env: env.step(np.zeros(6)), env.render):
            with pytest.raises(Exception, match="call reset before step and render"):
                call()
