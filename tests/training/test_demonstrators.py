"""A demonstrator acts in some environments, and a next skill says what a success is worth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from hrl_comfort.comfort.adapt import with_level
from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.envs.torchrl import CellEnv
from hrl_comfort.files.run_config import environment
from hrl_comfort.policies.actor import load_policy
from hrl_comfort.policies.load import make_policy
from hrl_comfort.tasks import subtask
from hrl_comfort.training.collector import Demonstrator, SkillCollector, make_demonstrator
from hrl_comfort.training.next_skill import NextSkill
from hrl_comfort.training.trainer import Training, train
from tests.point_env import LIMIT, PointEnv, interrupted, make_points, small_config


def homeward(env: PointEnv) -> Demonstrator:
    """A guide that goes straight to the origin."""
    return lambda rows: -env.point[rows].clamp(-1, 1)


def demonstrated(config: TrainConfig, stop_after: int | None = None) -> SkillCollector:
    env = PointEnv(config.engine.num_envs, config.episode_seed, stop_after)
    return SkillCollector(config.agent, env, homeward(env))


DEMONSTRATED = ("agent.demonstrator=potential_field", "agent.demonstrator_envs=2")


def test_guided_rows_act_as_the_guide_does_and_are_remembered_as_such(tmp_path):
    config = small_config(tmp_path, *DEMONSTRATED)
    env = PointEnv(8, 0)
    training = Training(config, lambda _: SkillCollector(config.agent, env, homeward(env)), tmp_path)
    expected = homeward(env)(torch.arange(2))
    training.step()
    stored = training.learner.buffer.storage[:8]
    assert torch.equal(stored["action"][:2], expected)
    assert stored["demonstrated"].tolist() == [True, True, *[False] * 6]


def test_a_guide_that_takes_over_goes_on_to_the_end_of_the_episode(tmp_path):
    config = small_config(tmp_path, *DEMONSTRATED, "agent.demonstrator_takeover=0.5")
    env = PointEnv(8, 0)
    collector = SkillCollector(config.agent, env, homeward(env))
    collector.reset(0.1)
    begun, guided_before = torch.zeros(8, dtype=torch.bool), torch.zeros(8, dtype=torch.bool)
    for _ in range(4 * LIMIT):
        expected = homeward(env)(torch.arange(8))
        transitions = collector.step(torch.ones(8, 2)).transitions
        guided = transitions["demonstrated"]
        assert torch.equal(transitions["action"], torch.where(guided[:, None], expected, torch.ones(8, 2)))
        assert guided[guided_before].all() and not guided[2:].any()
        begun |= ~guided
        guided_before = collector.demonstrated.clone()
    assert begun.all(), "the actor begins some of the first two environments' episodes"


def test_guided_episodes_count_in_no_success(tmp_path):
    config = small_config(tmp_path, *DEMONSTRATED, "curriculum=off", "task.precision.grasp_tolerance_m=0.3")
    env = PointEnv(8, 0)
    training = Training(
        config, lambda _: SkillCollector(config.agent, env, lambda rows: torch.zeros(len(rows), 2)), tmp_path
    )
    ended = 0
    for _ in range(LIMIT):
        env.point[2:] = 0.0  # whoever is not guided is there at once
        finished = training.step()
        assert all(outcome["success"] for outcome in finished)
        ended += len(finished)
    assert ended == 6 * LIMIT


def test_a_guided_training_stopped_half_way_and_resumed_is_bit_for_bit_the_same(tmp_path):
    whole = train(small_config(tmp_path / "whole", *DEMONSTRATED), demonstrated)
    half = interrupted(tmp_path / "half", 120, *DEMONSTRATED, make=demonstrated)
    train(small_config(half, resume=str(half)), demonstrated)
    assert (half / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


def test_a_guide_without_rows_and_rows_without_a_guide_are_refused(tmp_path):
    with pytest.raises(
        ConfigError, match=r"agent\.demonstrator_envs=0 does not go with agent\.demonstrator=potential_field"
    ):
        small_config(tmp_path, "agent.demonstrator=potential_field")
    with pytest.raises(ConfigError, match=r"agent\.demonstrator_envs=2 does not go with agent\.demonstrator=None"):
        small_config(tmp_path, "agent.demonstrator_envs=2")
    with pytest.raises(ConfigError, match=r"agent\.demonstrator_envs=8 must be below engine\.num_envs=8"):
        small_config(tmp_path, "agent.demonstrator=potential_field", "agent.demonstrator_envs=8")
    with pytest.raises(ConfigError, match="this environment knows no demonstrator"):
        train(small_config(tmp_path / "run", *DEMONSTRATED), make_points)


@pytest.mark.parametrize(
    ("demonstrator", "problem"),
    [
        ("random", "agent.demonstrator=random demonstrates nothing"),
        ("nobody", "agent.demonstrator=nobody: policy='nobody' is not there"),
    ],
)
def test_a_guide_that_cannot_guide_is_named(tmp_path, demonstrator, problem):
    config = small_config(
        tmp_path / "run",
        "task=pick_place",
        f"agent.demonstrator={demonstrator}",
        "agent.demonstrator_envs=2",
        "engine.num_envs=4",
    )
    with pytest.raises(ConfigError, match=problem):
        train(config)


@pytest.mark.parametrize("demonstrator", ["potential_field", "expert"])
def test_in_the_cell_a_guide_acts_for_the_first_rows(tmp_path, demonstrator):
    choices = (
        f"agent.demonstrator={demonstrator}",
        "agent.demonstrator_envs=2",
        "engine.num_envs=4",
        "agent.policy_steps=8",
    )
    config = small_config(tmp_path / "run", "task=pick_place", "comfort=conditioned", *choices)
    env = CellEnv(environment(config), 4, config.episode_seed)
    env.reset()
    episodes = env.engine.episodes
    act = make_policy(demonstrator, episodes.subtask, env.engine.scene, environment(config), 0)
    expected = act(episodes.state.rows(torch.arange(2)))
    assert expected.abs().max() > 0
    torch.testing.assert_close(make_demonstrator(config, env)(torch.arange(2)), expected)
    train(config)


def test_a_success_is_worth_what_the_successor_makes_of_it(tmp_path):
    choices = (
        "curriculum=off",
        "task.precision.grasp_tolerance_m=0.3",
        "agent.next_skill=next",
        "agent.gamma=0.5",
    )
    config = small_config(tmp_path, *choices)

    def next_skill(success: Tensor) -> Tensor:
        return success * 100.0

    rewards = []
    for value in (None, next_skill):
        env = PointEnv(8, 0)
        agent = replace(config.agent, next_skill=value and "next")
        collector = SkillCollector(agent, env, next_skill=value)
        training = Training(config, lambda _, made=collector: made, tmp_path)
        env.point[:4], env.point[4:] = 0.0, 0.9  # four are there at once
        training.step()
        rewards.append(training.learner.buffer.storage[:8]["next", "reward"][:, 0])
    expected = torch.zeros(8)
    expected[:4] = 100.0 * 0.5 ** env.rand_step()["next", "decision_steps"][0, 0]
    torch.testing.assert_close(rewards[1] - rewards[0], expected)
    with pytest.raises(ConfigError, match="this environment knows no next_skill"):
        train(small_config(tmp_path / "run", "agent.next_skill=next"), make_points)


def trained(folder: Path, task: str, *overrides: str) -> Path:
    choices = ("curriculum=off", "engine.num_envs=4", "agent.policy_steps=40", f"task={task}", *overrides)
    return train(small_config(folder, *choices))


def test_in_the_cell_the_successor_sees_what_it_would_begin_with(tmp_path):
    place = trained(tmp_path / "place", "place", "comfort=conditioned")
    config = small_config(
        tmp_path / "pick",
        "task=pick",
        "comfort=conditioned",
        "engine.num_envs=4",
        f"agent.next_skill={place}",
    )
    env = CellEnv(environment(config), 4, config.episode_seed)
    value_of = NextSkill(config).value(env)
    env.rollout(1)
    assert env.last is not None
    values = value_of(torch.tensor([True, False, True, False]))
    task = with_level(subtask("place", config.task.observation, 1), config.comfort.levels)
    expected = load_policy(place, critics=True).value(task.observe(env.last.state).float())
    torch.testing.assert_close(values[[0, 2]], expected[[0, 2]])
    assert values[[1, 3]].tolist() == [0.0, 0.0]


def test_a_demonstrator_for_another_task_is_named(tmp_path):
    pick = trained(tmp_path / "pick", "pick")
    with pytest.raises(ConfigError, match=r"agent\.demonstrator=.*was trained for 'pick', not for 'place'"):
        trained(tmp_path / "on", "place", f"agent.demonstrator='{pick}'", "agent.demonstrator_envs=2")


def test_a_successor_that_begins_elsewhere_is_named(tmp_path):
    pick = trained(tmp_path / "pick", "pick")
    for task, named, problem in (
        ("place", pick, "pick does not begin where place ends"),
        ("place", "nowhere", "nowhere: no such file"),
    ):
        with pytest.raises(ConfigError, match=problem):
            trained(tmp_path / "on", task, f"agent.next_skill={named}")
