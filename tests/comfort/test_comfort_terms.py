"""Comfort terms: the equations of the paper, of its code and of this project, and the worked examples."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from hrl_comfort.comfort import terms
from hrl_comfort.comfort.adapt import max_episode_steps, with_comfort
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ComfortConfig, TrainConfig
from hrl_comfort.files.run_config import environment
from hrl_comfort.sim.engine import Engine
from hrl_comfort.tasks import SUBTASKS


def comfort(**changes: Any) -> ComfortConfig:
    config = compose("train", ["comfort=conditioned"])
    assert isinstance(config, TrainConfig)
    return replace(config.comfort, **changes)


def number(value: float) -> Tensor:
    return torch.tensor([value], dtype=torch.float64)


def test_worked_example_of_distance_holds_with_the_threshold_over_the_range() -> None:
    config = comfort(form="paper", threshold="range", min_m=0.2, max_m=1.2)
    uneasy = terms.distance_term(number(0.45), number(3), config).item()
    at_ease = terms.distance_term(number(0.45), number(6), config).item()
    assert uneasy < -0.1 < at_ease < 0


@pytest.mark.parametrize("threshold", ["reference", "levels"])
def test_worked_example_of_distance_fails_with_the_other_thresholds(threshold: str) -> None:
    config = comfort(form="paper", threshold=threshold, min_m=0.2, max_m=1.2)
    assert terms.distance_term(number(0.45), number(6), config).item() < -0.1


def test_a_negative_distance_counts_as_zero() -> None:
    config = comfort(form="logarithmic")
    inside, touching = (terms.distance_term(number(d), number(3), config).item() for d in (-1.0, 0.0))
    assert inside == touching


def test_worked_example_of_joint_increments_holds() -> None:
    config = comfort(speed_form="paper")
    assert terms.speed_term(number(0.85), number(4), 2.0, config).item() == -0.1
    assert terms.speed_term(number(0.85), number(6), 2.0, config).item() == 0


def test_printed_form_is_positive_beyond_its_threshold_and_target_distance_never() -> None:
    distance = torch.linspace(0.0, 3.0, 301, dtype=torch.float64)
    for level in range(1, 11):
        row = torch.full_like(distance, level)
        assert (terms.distance_term(distance, row, comfort(form="target_distance")) <= 0).all()
        assert (terms.distance_term(distance, row, comfort(form="reference", max_m=1.5)) <= 0).all()
    printed = terms.distance_term(distance, row, comfort(form="paper", threshold="range"))
    assert printed.max() > 0.5


@pytest.mark.parametrize("form", list(terms.FORMS))
@pytest.mark.parametrize("threshold", list(terms.THRESHOLDS))
def test_every_form_is_finite_at_every_distance_and_level(form: str, threshold: str) -> None:
    config = comfort(form=form, threshold=threshold)
    distance = torch.tensor([0.0, 1e-12, 0.3, config.max_m, 5.0, 50.0], dtype=torch.float64)
    for level in (1, 5, 10):
        value = terms.distance_term(distance, torch.full_like(distance, level), config)
        assert value.shape == distance.shape and value.isfinite().all()


def test_printed_form_matches_a_hand_computed_value() -> None:
    config = comfort(form="paper", threshold="range", min_m=0.2, max_m=1.2)
    expected = -0.1 + math.tanh((0.45 - 0.7) / 0.45) * (1.2 - 0.45)
    assert terms.distance_term(number(0.45), number(3), config).item() == pytest.approx(expected)


def test_released_form_matches_a_hand_computed_value() -> None:
    config = comfort(form="reference", threshold="reference", max_m=1.5)
    theta = 1.5 * (1 - 4 / 10)
    expected = 0.1 * (-1 + math.tanh(((0.6 - theta) / 0.6) / (1.5 - 0.6)))
    assert terms.distance_term(number(0.6), number(4), config).item() == pytest.approx(expected)


def test_the_one_sided_form_costs_nothing_beyond_theta_at_level_1_and_else_is_the_two_sided_one() -> None:
    config = comfort(form="target_distance_one_sided", min_m=0.4, max_m=1.2, power=2, time_penalty=0.1)
    far = terms.distance_term(torch.tensor([1.3, 2.0], dtype=torch.float64), number(1), config)
    assert far.tolist() == [0, 0]
    half = terms.distance_term(number(1.2), number(5.5), config)
    assert half.item() == pytest.approx(-((0.5 * 0.4 / 0.8) ** 2) - 0.05)
    bounded = replace(config, form="target_distance")
    for distance, level in ((0.7, 1), (0.7, 4), (0.9, 10), (2.0, 10)):
        alike = [terms.distance_term(number(distance), number(level), each) for each in (config, bounded)]
        assert alike[0].item() == pytest.approx(alike[1].item())


def test_minimum_distance_costs_what_the_two_sided_form_does_nearer_than_theta_and_time_alone_beyond() -> None:
    config = comfort(form="minimum_distance", min_m=0.2, max_m=1.0, power=2, time_penalty=0.1)
    near, far = torch.tensor([0.2, 0.6], dtype=torch.float64), torch.tensor([0.61, 3.0], dtype=torch.float64)
    level = torch.full((2,), 5.5, dtype=torch.float64)  # theta is 0.6 m
    assert terms.distance_term(near, level, config).tolist() == pytest.approx([-0.25 - 0.05, -0.05])
    assert terms.distance_term(far, level, config).tolist() == pytest.approx([-0.05, -0.05])


def test_what_an_arm_at_home_would_lose_costs_nothing() -> None:
    config = comfort(form="minimum_distance", min_m=0.2, max_m=1.0, power=2, time_penalty=0.1)
    level = torch.ones(3, dtype=torch.float64)
    arm, home = torch.tensor([[0.6, 0.4, 0.3], [0.5, 0.5, 0.5]], dtype=torch.float64)
    told = terms.distance_term(arm, level, config, home)
    assert told[0] == 0
    torch.testing.assert_close(
        told, terms.distance_term(arm, level, config) - terms.distance_term(torch.maximum(arm, home), level, config)
    )
    fast = terms.distance_term(arm, 10 * level, config, home)
    assert (fast == -config.time_penalty).all()


@pytest.mark.parametrize("form", sorted(terms.FORMS))
def test_being_nearer_than_an_arm_at_home_is_never_paid(form: str) -> None:
    config = comfort(form=form, min_m=0.2, max_m=1.0, time_penalty=0.0)
    arm = torch.linspace(0.05, 1.5, 30, dtype=torch.float64)
    assert (terms.distance_term(arm, torch.full_like(arm, 6), config, 2 * arm) <= 0).all()


def test_an_arm_that_rests_at_home_is_paid_no_discomfort_beside_a_person() -> None:
    words = ("human=still", "comfort=distance_and_speed", "comfort.source=fixed", "comfort.level=1", "task.start=ik")
    paid = {}
    for distance in "arm", "avoidable":
        engine = Engine(environment(compose("train", [*words, f"comfort.distance={distance}"])), 4, 0)
        engine.reset()
        result = engine.step(np.zeros((4, 6)))
        paid[distance] = result.reward_terms[:, engine.episodes.reward_names.index("comfort")]
        engine.close()
    assert (paid["arm"] < 0).any()
    assert (paid["avoidable"].abs() <= 1e-3 * paid["arm"].abs() + 1e-9).all()


def test_thresholds_are_those_of_the_sources() -> None:
    config = comfort(min_m=0.2, max_m=1.2)
    at = {name: threshold(number(6), config).item() for name, threshold in terms.THRESHOLDS.items()}
    assert at == pytest.approx({"range": 0.4, "reference": 0.48, "levels": 1.2 - 5 / 9})


def test_hinge_costs_nothing_below_its_threshold_and_grows_from_there() -> None:
    config = comfort(speed_form="hinge")
    increments = torch.tensor([0.0, 0.8, 1.2, 2.0], dtype=torch.float64)
    value = terms.speed_term(increments, torch.full_like(increments, 4), 2.0, config)
    assert value.tolist() == pytest.approx([0, 0, -0.04, -0.36])


def test_weights_blend_the_two_terms() -> None:
    config = comfort(alpha=0.5, beta=1.0)
    distance, level = number(0.5), number(2)
    parts = [terms.distance_term(distance, level, config), terms.speed_term(number(2.0), level, 2.0, config)]
    both = terms.comfort(distance, number(2.0), level, 2.0, config)
    assert both.item() == pytest.approx(0.5 * parts[0].item() + parts[1].item())


def test_without_a_source_there_is_no_observation_and_no_reward() -> None:
    config = compose("train", ["comfort=off"])
    assert isinstance(config, TrainConfig)
    assert with_comfort(SUBTASKS["pick"], config.comfort, 2.0) is SUBTASKS["pick"]
    seen = with_comfort(SUBTASKS["pick"], comfort(), 2.0)
    assert list(seen.observations)[-1] == "level" and list(seen.rewards)[-1] == "comfort"


def test_time_limit_grows_at_low_levels_where_speed_counts() -> None:
    level = torch.tensor([1.0, 5.0, 10.0], dtype=torch.float64)
    assert max_episode_steps(level, 500, comfort(beta=1.0)).tolist() == [5000, 1000, 500]
    assert max_episode_steps(level, 500, comfort(beta=0.0)).tolist() == [500, 500, 500]


def test_discomfort_is_what_is_nearer_or_faster_than_the_level_allows() -> None:
    config = comfort(min_m=0.3, max_m=1.2, power=2)
    slow = number(0.0)
    assert terms.discomfort(number(1.2), slow, number(1), 2.0, config).item() == 0
    assert terms.discomfort(number(3.0), slow, number(1), 2.0, config).item() == 0, "far away nothing is missed"
    assert terms.discomfort(number(0.75), slow, number(1), 2.0, config).item() == pytest.approx(0.25)
    assert terms.discomfort(number(0.3), number(2.0), number(10), 2.0, config).item() == pytest.approx(0)
    assert terms.discomfort(number(2.0), number(1.2), number(1), 2.0, config).item() == pytest.approx(0.25)
    assert terms.discomfort(number(-0.1), number(2.0), number(1), 2.0, config).item() == pytest.approx(1 + 0.81)
