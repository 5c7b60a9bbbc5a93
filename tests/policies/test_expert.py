"""The scripted expert solves every subtask beside a walking person."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from hrl_comfort.config import ConfigError
from hrl_comfort.config.compose import compose, environment
from hrl_comfort.humans import load_evaluation_set
from hrl_comfort.policies.expert import SLOWEST, Expert
from hrl_comfort.sim.engine import Engine

TASKS = ("reach", "point_to_point", "pick", "place", "return", "pick_place", "cycle")
EPISODES = 20


def success(task: str) -> float:
    """Return the share of the first EPISODES evaluation episodes in which the expert succeeds."""
    config = environment(compose("train", [f"task={task}"]))
    engine = Engine(config, EPISODES, 0, evaluation=load_evaluation_set())
    state = engine.reset()
    expert = Expert(engine.scene, config, engine.episodes.subtask)
    executor, solved = torch.ones(EPISODES, dtype=torch.bool), 0
    while executor.any():
        action = np.zeros((EPISODES, 6))
        action[executor.numpy()] = expert.act(state.rows(executor)).numpy()
        assert np.abs(action).max() <= 1.0 + 1e-12
        outcome = engine.step(action)
        state = outcome.state
        solved += int((outcome.success & executor).sum())
        executor &= ~outcome.done
    return solved / EPISODES


@pytest.mark.parametrize("task", TASKS)
def test_the_expert_solves_the_task_beside_a_walking_person(task: str) -> None:
    assert success(task) >= 0.9


def test_the_expert_does_the_same_with_any_subset_of_rows() -> None:
    config = environment(compose("train", ["task=pick"]))
    engine = Engine(config, 6, 0, evaluation=load_evaluation_set())
    state = engine.reset()
    expert = Expert(engine.scene, config, engine.episodes.subtask)
    together = expert.act(state)
    alone = torch.cat([expert.act(state.rows(torch.tensor([row]))) for row in range(6)])
    assert together.abs().amax() > 0.5
    torch.testing.assert_close(together, alone, atol=1e-9, rtol=0)


def test_the_expert_goes_home_when_the_stage_is_return() -> None:
    config = environment(compose("train", ["task=return", "human=none"]))
    engine = Engine(config, 4, 0)
    state = engine.reset()
    expert = Expert(engine.scene, config, engine.episodes.subtask)
    before = state.joint_home - state.joint_pos
    for _ in range(8):
        state = engine.step(expert.act(state).numpy()).state
    assert ((state.joint_home - state.joint_pos).abs().amax(-1) < before.abs().amax(-1)).all()


def test_the_expert_refuses_cartesian_actions() -> None:
    config = environment(compose("train", ["task=pick"]))
    engine = Engine(config, 1, 0)
    cartesian = replace(config, task=replace(config.task, action="cartesian"))
    with pytest.raises(ConfigError, match=r"task\.action"):
        Expert(engine.scene, cartesian, engine.episodes.subtask)


def test_the_expert_is_slower_and_stays_farther_from_a_person_at_level_1_than_at_level_10() -> None:
    levelled = ["task=pick", "comfort=distance_and_speed", "comfort.source=fixed", "human=patrol"]
    distance, speed = {}, {}
    for level in (1, 10):
        config = environment(compose("train", [*levelled, f"comfort.level={level}"]))
        engine = Engine(config, EPISODES, 800_000)
        state, expert = engine.reset(), Expert(engine.scene, config, engine.episodes.subtask)
        speed[level] = float(expert.act(state).abs().amax())
        apart = []
        for _ in range(12):
            state = engine.step(expert.act(state).numpy()).state
            apart.append(state.arm_distance.mean().item())
        distance[level] = np.mean(apart)
    assert (speed[1], speed[10]) == pytest.approx((SLOWEST, 1.0))
    assert distance[1] > distance[10] + 0.02
