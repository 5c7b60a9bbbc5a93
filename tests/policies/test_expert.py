"""The scripted expert solves every subtask beside a walking person."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.files.run_config import environment
from hrl_comfort.humans import load_evaluation_set
from hrl_comfort.policies.expert import (
    CONSIDERED,
    FORESIGHT_STEPS,
    PARTS,
    SLOWEST,
    WAIT_STEPS,
    Array,
    Expert,
    Goal,
)
from hrl_comfort.sim.engine import Engine

TASKS = ("reach", "point_to_point", "pick", "place", "return", "pick_place", "cycle")
EPISODES = 20


def success(task: str, *overrides: str) -> float:
    """Return the share of the first EPISODES evaluation episodes in which the expert succeeds."""
    config = environment(compose("train", [f"task={task}", *overrides]))
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


def test_the_expert_brakes_a_rated_arm_before_furniture_that_stands_anywhere() -> None:
    rated = ("robot.rating=collaborative", "safety=ssm", "task.terminate_on=unsafe_contact")
    assert success("place", "cell=varied", "human=none", "task.arrival_speed_rad_s=0.5", *rated) == 1.0


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


def exhaustive(expert: Expert, joints: Array, person: Array, goal: Goal, price: float) -> tuple[Array, Array]:
    """Return the legs' ends (M, 6) and their costs (M,), every leg after every way weighed."""
    postures = expert._postures(goal, more=True)
    steps, risk = expert._weigh(joints, postures, person)
    direct = steps + price * risk
    blocked = not expert._cell.free(joints, postures[direct.argmin()])
    safest = np.argsort(steps + price * expert._weigh(postures, postures, person)[1])[:CONSIDERED]
    raised = expert._cell.raised(joints) if blocked else joints[None]
    ways = np.concatenate([expert._here.upright, np.where(PARTS, expert._here.home, joints), raised])
    first_steps, first_risk = expert._weigh(joints, ways, person)
    steps_on, risk_on = expert._weigh(ways[:, None], postures[safest], person, first_steps[:, None])
    clear = np.tile(first_steps[:, None] > 1.0, (1, len(safest)))
    for way in range(len(expert._here.upright)):
        clear[way] &= expert._clear(goal, safest, way)
    onward = np.where(clear, steps_on + price * risk_on, np.inf).min(axis=1)
    exposed = expert._weigh(ways, ways, person, first_steps + FORESIGHT_STEPS / 2)[1]
    waiting = WAIT_STEPS + steps_on.min(axis=1) + price * exposed
    cost = np.concatenate([direct, first_steps + price * first_risk + np.minimum(onward, waiting)])
    return np.concatenate([postures, ways]), cost


@pytest.mark.parametrize(("margin", "pace"), [(0.0, 1.0), (0.3, 0.5), (0.5, 0.2)])
def test_weighing_ways_best_first_finds_a_cheapest_one(margin: float, pace: float) -> None:
    config = environment(compose("train", ["task=place", "human=patrol"]))
    engine = Engine(config, 12, 0)
    state, expert = engine.reset(), Expert(engine.scene, config, engine.episodes.subtask)
    for row in range(12):
        joints, goal = state.joint_pos[row].numpy(), tuple(state.target_place[row].numpy().round(6))
        person = np.array([*state.humans_pos[row, 0], state.humans_yaw[row, 0], margin, pace])
        chosen = expert._deliberate(joints, person, goal, 1500.0)
        ends, cost = exhaustive(expert, joints, person, goal, 1500.0)
        free = np.array([expert._cell.free(joints, end) for end in ends])
        (same,) = np.nonzero((ends == chosen).all(axis=1))
        assert cost[same].min() == cost[free].min()


def test_the_scripted_policy_that_does_not_hold_is_named() -> None:
    with pytest.raises(
        ConfigError, match=r"^robot\.gripper\.name=two_finger is not allowed with policy=direct; choose"
    ):
        rollout(compose("evaluate", ["task=return", "cell=grasp", "policy=direct", "episodes=1"]))
