"""The dm_control front keeps dm_env's contract and the conventions of the DeepMind Control Suite."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import dm_env
import numpy as np
import pytest
from absl.testing import absltest
from dm_control.rl.control import FLAT_OBSERVATION_KEY, Environment
from dm_env import test_utils

import hrl_comfort
from hrl_comfort.config import ConfigError
from hrl_comfort.tasks import SUBTASKS

TASKS = sorted(SUBTASKS)
ENVIRONMENTS = {task: hrl_comfort.load(task) for task in ("cycle", "pick", "reach")}
NAMED = (
    ("body", "nbody"), ("joint", "njnt"), ("geom", "ngeom"), ("site", "nsite"), ("camera", "ncam"),
    ("light", "nlight"), ("mesh", "nmesh"), ("texture", "ntex"), ("material", "nmat"), ("actuator", "nu"),
    ("sensor", "nsensor"),
)  # fmt: skip


class ContractTest(test_utils.EnvironmentTestMixin, absltest.TestCase):
    """dm_env's own tests, on episodes that end."""

    def make_object_under_test(self) -> Environment:
        return hrl_comfort.load("pick", **{"task.max_episode_steps": 30})

    def make_action_sequence(self) -> Iterator[np.ndarray]:
        for _ in range(14):
            yield np.full(6, 0.1)


def random_steps(env: Environment, seed: int, episodes: int = 2, most: int = 4) -> Iterator[dm_env.TimeStep]:
    """Yield the time steps of uniform random actions, drawn as the suite's own tests draw them."""
    spec, state = env.action_spec(), np.random.RandomState(seed)
    for _ in range(episodes):
        step = env.reset()
        yield step
        for _ in range(most):
            step = env.step(state.uniform(spec.minimum, spec.maximum))
            yield step
            if step.last():
                break


@pytest.mark.parametrize("task", TASKS)
def test_steps_conform_to_their_specs(task: str) -> None:
    env = hrl_comfort.load(task)
    actions, observations = env.action_spec(), env.observation_spec()
    assert actions.minimum.tolist() == [-1.0] * 6 and actions.maximum.tolist() == [1.0] * 6
    before = None
    for step in random_steps(env, 0):
        assert set(step.observation) == set(observations)
        for name, value in step.observation.items():
            assert (value.shape, value.dtype) == (observations[name].shape, observations[name].dtype)
            assert np.isfinite(value).all()
            assert before is None or not np.may_share_memory(before.observation[name], value)
        if not step.first():
            assert isinstance(step.reward, float) and isinstance(step.discount, float) and 0 <= step.discount <= 1
        before = step
    model = env.physics.model
    assert model.ncam >= 2
    for kind, count in NAMED:
        assert all(model.id2name(index, kind) for index in range(getattr(model, count))), kind


@pytest.mark.parametrize("task", TASKS)
def test_a_seed_gives_the_same_trajectory(task: str) -> None:
    for first, second in zip(*(random_steps(hrl_comfort.load(task, seed=5), 0) for _ in range(2)), strict=True):
        assert (first.step_type, first.reward, first.discount) == (second.step_type, second.reward, second.discount)
        for name, value in first.observation.items():
            np.testing.assert_array_equal(value, second.observation[name])


@pytest.mark.parametrize("task", TASKS)
def test_the_observation_can_be_flat(task: str) -> None:
    flat, named = hrl_comfort.load(task, flat_observation=True), hrl_comfort.load(task)
    assert set(flat.observation_spec()) == {FLAT_OBSERVATION_KEY}
    values = np.concatenate([value.ravel() for value in named.reset().observation.values()])
    np.testing.assert_array_equal(flat.reset().observation[FLAT_OBSERVATION_KEY], values)


def test_the_suite_may_ask_to_visualise_the_reward() -> None:
    env = ENVIRONMENTS["reach"]
    env.task.visualise_reward = True
    env.reset()
    env.step(np.zeros(6))


def test_clients_seed_a_task_by_its_random_state() -> None:
    env, seen = ENVIRONMENTS["pick"], []
    for seed in (3, 4, 3):
        env.task._random = np.random.RandomState(seed)
        seen.append(env.reset().observation["human"])
    assert (seen[0] == seen[2]).all() and (seen[0] != seen[1]).any()


@pytest.mark.parametrize("seed", [-1, 1.5, 2**70, None, "1"])
def test_other_seeds_are_refused(seed: Any) -> None:
    with pytest.raises(ConfigError, match=r"seed=.* must be a whole number from 0 to 4294967295"):
        hrl_comfort.load("reach", seed=seed)


def test_an_unknown_keyword_is_a_type_error() -> None:
    with pytest.raises(TypeError, match="unexpected keyword argument 'environment_kwargs'"):
        hrl_comfort.load("reach", environment_kwargs={"flat_observation": True})
