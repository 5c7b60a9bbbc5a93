"""Experience at one comfort level teaches the others."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor

from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.training.collector import SkillCollector, make_collector
from tests.point_env import small_config

LEVELS = 10


def config_in(folder: Path, *overrides: str) -> TrainConfig:
    choices = ("task=pick", "curriculum=off", "engine.num_envs=8", "agent.policy_steps=40", *overrides)
    return small_config(folder, *choices)


def begun(config: TrainConfig) -> SkillCollector:
    collector = make_collector(config)
    collector.reset(0.1)
    return collector


def moved(count: int) -> Tensor:
    return torch.rand(count, 6, generator=torch.Generator().manual_seed(count)) * 2 - 1


@pytest.mark.parametrize("shield", ["none", "ssm"])
def test_a_relabelled_transition_has_the_reward_and_the_observation_of_its_new_level(tmp_path, shield):
    levelled = ("comfort=distance_and_speed", f"safety={shield}", "robot.rating=collaborative")
    guided = ("agent.demonstrator=potential_field", "agent.demonstrator_envs=2")
    plain = begun(config_in(tmp_path, *levelled, *guided))
    relabelled = begun(config_in(tmp_path, *levelled, *guided, "agent.other_level=1"))
    column = -1 if shield == "none" else -2
    changed = 0
    for _ in range(5):
        own, other = (each.step(moved(8)).transitions for each in (plain, relabelled))
        for part in ((own, other), (own["next"], other["next"])):
            seen, shown = (each["observation"].clone() for each in part)
            seen[:, column] = shown[:, column]
            assert torch.equal(seen, shown), "but for the level, all is as it was"
        level = (other["observation"][:, column] * (LEVELS - 1)).round() + 1
        assert torch.equal(level[:2], (own["observation"][:2, column] * (LEVELS - 1)).round() + 1)
        same = other["observation"][:, column] == own["observation"][:, column]
        assert torch.equal(other["next", "reward"][same], own["next", "reward"][same])
        assert torch.equal(other["demonstrated"], own["demonstrated"])
        changed += int((other["next", "reward"] != own["next", "reward"]).sum())
        levels = relabelled._levels
        assert levels is not None
        mine = levels._reward(levels._env.last.level).float()
        paid = levels._env.last.reward_terms[:, relabelled.reward_names.index("comfort")].float()
        torch.testing.assert_close(mine, paid)
        gain = (levels._reward(level.double()).float() - paid)[:, None]
        torch.testing.assert_close(other["next", "reward"] - own["next", "reward"], gain.where(~same[:, None], 0.0))
    assert changed > 5


def test_it_goes_on_with_the_levels_that_it_would_have_drawn(tmp_path):
    config = config_in(tmp_path, "comfort=distance_and_speed", "agent.other_level=0.5")
    whole, again = begun(config), begun(config)
    whole.step(moved(8))
    again.load_state_dict(whole.state_dict())
    for _ in range(3):
        first, second = (each.step(moved(8)).transitions for each in (whole, again))
        assert torch.equal(first["observation"], second["observation"])
        assert torch.equal(first["next", "reward"], second["next", "reward"])


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ((), "comfort.source=none choose comfort.source=random or fixed"),
        (("comfort=distance_and_speed", "comfort.source=frightened"), "comfort.source=frightened choose"),
        (("comfort=distance_and_speed", "agent.next_skill=runs/place"), "leave one of them out"),
        (("comfort=distance_and_speed", "agent=hiro"), "does not go with agent=hiro"),
    ],
)
def test_levels_are_drawn_anew_only_where_a_transition_has_one(
    tmp_path: Path, words: tuple[str, ...], reason: str
) -> None:
    with pytest.raises(ConfigError, match=rf"agent\.other_level=0\.5 .*{reason}"):
        config_in(tmp_path, *words, "agent.other_level=0.5")
