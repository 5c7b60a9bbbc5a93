"""Subtasks: pure functions of State."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.files.run_config import environment
from hrl_comfort.policies.load import make_policy
from hrl_comfort.sim.engine import Engine
from hrl_comfort.tasks import SUBTASKS, State, subtask
from hrl_comfort.tasks.rewards import arrival_speed, overtime, return_shaping

TASKS = sorted(SUBTASKS)


def configured(*overrides: str) -> EnvConfig:
    return environment(compose("train", overrides))


def beginning(task: str, rows: int = 8, *overrides: str) -> State:
    engine = Engine(configured(f"task={task}", *overrides), rows, 0)
    return engine.reset()


@pytest.mark.parametrize("task", TASKS)
def test_no_episode_starts_solved_or_in_contact(task: str) -> None:
    state = beginning(task, 64)
    assert not subtask(task).success(state).any()
    assert not (subtask(task).next_stage(state) > 0).any()
    assert not subtask(task).failure(state).any()


@pytest.mark.parametrize("layout", ["default", "sight", "set_points"])
@pytest.mark.parametrize("task", TASKS)
def test_observation_is_finite_and_of_the_order_of_one(task: str, layout: str) -> None:
    observation = subtask(task, layout).observe(beginning(task))
    assert observation.isfinite().all()
    assert observation.abs().max() <= 5.0


def test_set_points_tell_a_late_arm_what_it_is_still_to_do() -> None:
    lag = ("randomise.latency_s=[0.2,0.2]", "task.observation=set_points")
    late, prompt = (Engine(configured("task=pick", *more), 4, 0) for more in (lag, lag[1:]))
    seen, action = subtask("pick", "set_points"), np.ones((4, 6))
    states = [(engine.reset(), engine.step(action).state)[1] for engine in (late, prompt)]
    pending = [seen.observe(state)[:, -6:] * math.pi for state in states]
    # Five steps of 2 degrees were commanded; after 0.1 s nothing of them has come where it takes 0.2 s.
    torch.testing.assert_close(pending[0], torch.full((4, 6), math.radians(10.0)).double(), atol=2e-3, rtol=0)
    assert (pending[1] < pending[0] - math.radians(5.0)).all()


def test_paper_observation_has_18_numbers_and_hides_the_object_once_held() -> None:
    state = beginning("pick_place")
    seen = subtask("pick_place", "paper")
    before = seen.observe(state)
    held = seen.observe(state.with_(stage=torch.ones_like(state.stage)))
    assert before.shape == (8, 18)
    torch.testing.assert_close(before[:, 8:11], state.target_object - state.tcp_pos)
    assert (held[:, 8:11] == 0).all()
    assert set(before[:, 17].tolist()) <= {0.0, 1.0}


def test_paper_observation_of_return_is_joint_error_in_degrees() -> None:
    state = beginning("return")
    seen = subtask("return", "paper").observe(state)
    torch.testing.assert_close(seen[:, 8:14], torch.rad2deg(state.joint_home - state.joint_pos))


def test_pick_is_done_just_inside_take_and_not_just_outside() -> None:
    state = beginning("pick")
    pick = subtask("pick")
    offset = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    inside = state.with_(tcp_pos=state.target_object + offset * (state.grasp_tolerance[:, None] - 1e-6))
    outside = state.with_(tcp_pos=state.target_object + offset * (state.grasp_tolerance[:, None] + 1e-6))
    assert (pick.next_stage(inside) == 1).all()
    assert (pick.next_stage(outside) == 0).all()


def test_a_stage_with_an_arrival_speed_is_done_by_a_slower_arm_only() -> None:
    state = Engine(configured("task=pick", "task.arrival_speed_rad_s=0.5"), 4, 0).reset()
    at_object = state.with_(tcp_pos=state.target_object)
    moving = torch.full_like(state.joint_vel, 0.5 / math.sqrt(6))
    task = replace(subtask("pick"), arrival_speed=0.5)
    assert (task.next_stage(at_object.with_(joint_vel=0.99 * moving)) == 1).all()
    assert (task.next_stage(at_object.with_(joint_vel=1.01 * moving)) == 0).all()
    assert (subtask("pick").next_stage(at_object.with_(joint_vel=2 * moving)) == 1).all()


def test_an_episode_ends_no_sooner_than_its_arm_is_slow() -> None:
    ended = []
    for speed in ("null", "0.3"):
        said = configured("task=pick", "human=none", f"task.arrival_speed_rad_s={speed}")
        engine = Engine(said, 8, 0)
        act = make_policy("expert", engine.episodes.subtask, engine.scene, said, 0)
        state = engine.reset()
        done = torch.zeros(8, dtype=torch.bool)
        rates = torch.zeros(8, dtype=torch.float64)
        while not done.all():
            result = engine.step(act(state).numpy())
            now = result.success & ~done
            rates[now] = torch.linalg.vector_norm(result.state.joint_vel[now], dim=-1)
            done |= result.done
            state = engine.reset(np.flatnonzero(result.done.numpy()))
        ended.append(rates)
        engine.close()
    free, slow = ended
    assert free.max() > 0.5 and (slow < 0.3).all()


def test_place_goes_to_where_the_kind_of_object_belongs() -> None:
    for index, kind in enumerate(("orange", "pink")):
        config = configured("task=place", f"task.object={kind}")
        state = Engine(config, 4, 0).reset()
        wanted = torch.tensor(config.cell.centre(kind, f"{kind}_table"), dtype=torch.float64)
        goal = subtask("place").stages[0].goal(state)
        torch.testing.assert_close(goal, wanted.expand(4, 3))
        assert (state.target_kind == index).all()


def test_return_needs_every_joint_home_and_a_full_turn_is_not_home() -> None:
    state = beginning("return")
    task = subtask("return")
    home = state.with_(joint_pos=state.joint_home.clone())
    assert (task.next_stage(home) == 1).all()
    turned = home.joint_pos.clone()
    turned[:, 5] += 2 * math.pi
    assert (task.next_stage(home.with_(joint_pos=turned)) == 0).all()
    off = home.joint_pos.clone()
    off[:, 2] += state.home_tolerance + 1e-6
    assert (task.next_stage(home.with_(joint_pos=off)) == 0).all()


def test_pick_place_advances_one_stage_at_a_time() -> None:
    state = beginning("pick_place")
    task = subtask("pick_place")
    at_object = state.with_(tcp_pos=state.target_object)
    picked = at_object.with_(stage=task.next_stage(at_object))
    assert (picked.stage == 1).all() and not task.success(picked).any()
    at_drop = picked.with_(tcp_pos=state.target_place)
    assert task.success(at_drop.with_(stage=task.next_stage(at_drop))).all()


@pytest.mark.parametrize("task", TASKS)
def test_every_reward_term_has_a_weight_in_every_reward_choice(task: str) -> None:
    for choice in ("dense", "sparse"):
        weights = vars(configured(f"task={task}", f"reward={choice}").reward)
        assert set(subtask(task).rewards) <= set(weights)


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("reward", ["dense", "sparse"])
def test_named_reward_terms_sum_to_the_reward(task: str, reward: str) -> None:
    engine = Engine(configured(f"task={task}", f"reward={reward}"), 16, 0)
    engine.reset()
    rng = np.random.default_rng(0)
    for _ in range(5):
        outcome = engine.step(rng.uniform(-1, 1, (16, 6)))
        assert outcome.reward_terms.shape == (16, len(engine.episodes.reward_names))
        torch.testing.assert_close(outcome.reward, outcome.reward_terms.sum(dim=-1))


def test_sparse_rewards_are_the_papers_50_100_150() -> None:
    weights = configured("task=cycle", "reward=sparse").reward
    assert (weights.pick, weights.place, weights.home) == (50, 100, 150)


def test_progress_telescopes_to_the_distance_covered() -> None:
    engine = Engine(configured("task=pick", "human=none"), 8, 0)
    first = engine.reset()
    rng = np.random.default_rng(1)
    gained = torch.zeros(8, dtype=torch.float64)
    alive = torch.ones(8, dtype=torch.bool)
    index = engine.episodes.reward_names.index("progress")
    for _ in range(3):
        outcome = engine.step(0.3 * rng.uniform(-1, 1, (8, 6)))
        gained += outcome.reward_terms[:, index]
        alive &= ~outcome.done
    distance = subtask("pick").stages[0].distance
    covered = distance(first) - distance(outcome.state)
    assert alive.any()
    torch.testing.assert_close(gained[alive] / 10.0, covered[alive])


def test_arrival_speed_is_charged_once_at_the_step_that_completes_a_stage() -> None:
    before = beginning("pick", 2)
    moving = before.with_(joint_vel=torch.tensor([3.0, 0, 0, 4.0, 0, 0], dtype=torch.float64).expand(2, 6))
    torch.testing.assert_close(arrival_speed(before, moving), torch.zeros(2, dtype=torch.float64))
    arrived = moving.with_(stage=before.stage + 1)
    torch.testing.assert_close(arrival_speed(before, arrived), torch.full((2,), 5.0, dtype=torch.float64))


def test_return_shaping_is_the_released_codes() -> None:
    state = beginning("return", 2)
    moved = state.with_(tcp_pos=state.tcp_home + torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64))
    expected = torch.full((2,), -math.log(2.0) / 10.0, dtype=torch.float64)
    torch.testing.assert_close(return_shaping(state, moved), expected)


def test_home_tolerance_scales_with_the_precision_from_30_to_10_degrees() -> None:
    engine = Engine(configured("task=return"), 4, 0)
    engine.episodes.precision_m = 0.30
    coarse = engine.reset()
    torch.testing.assert_close(coarse.home_tolerance, torch.full((4,), math.radians(30.0), dtype=torch.float64))
    engine.episodes.precision_m = 0.10
    fine = engine.reset()
    torch.testing.assert_close(fine.home_tolerance, torch.full((4,), math.radians(10.0), dtype=torch.float64))


def test_objects_belong_at_least_70_cm_from_where_they_arrive() -> None:
    cell = configured().cell
    for kind, each in cell.objects.items():
        assert math.dist(cell.centre(kind, each.arrives_at), cell.centre(kind, each.belongs_at)) >= 0.7


def test_unknown_task_names_what_is_allowed() -> None:
    with pytest.raises(ConfigError, match=r"'juggle' is not allowed; choose one of .*pick"):
        subtask("juggle")


def test_only_what_takes_longer_than_any_way_round_is_late() -> None:
    state = beginning("pick")
    at = [state.with_(steps=torch.full_like(state.steps, steps)) for steps in (150, 151)]
    assert [float(overtime(state, now).mean()) for now in at] == [0.0, 1.0]


@pytest.mark.parametrize(
    ("task", "places"),
    [
        ("cycle", ["arrival", "tool", "place", "place"]),
        ("pick", ["arrival", "tool"]),
        ("place", ["tool", "place"]),
        ("reach", ["nowhere"]),
    ],
)
def test_the_object_is_where_the_stage_says(task: str, places: list[str]) -> None:
    assert [subtask(task).location(stage) for stage in range(len(places))] == places
