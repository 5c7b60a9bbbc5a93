"""The fitted person is what its published figures say, its population is held out by split, and its level follows."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from hrl_comfort.comfort.fit import arm_speed, fit, held_out, published, ratings
from hrl_comfort.comfort.fitted import BODY_M, FITTED, PERSONS, expected, level_of, mean_rating, offsets, rating
from hrl_comfort.comfort.sources import Fitted, SourceInput, make_source
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ComfortConfig, TrainConfig
from hrl_comfort.humans import persons_of

FIGURES = published()
EVERYONE = torch.arange(PERSONS)


def comfort(*overrides: str) -> ComfortConfig:
    config = compose("train", ["comfort=conditioned", "comfort.source=fitted", *overrides])
    assert isinstance(config, TrainConfig)
    return config.comfort


def begun(persons: list[int], *overrides: str) -> Fitted:
    source = make_source(comfort(*overrides), len(persons))
    assert isinstance(source, Fitted)
    source.person[:] = persons
    source.begin(np.arange(len(persons)))
    return source


def beside(rows: int, arm_distance_m: float, speed_m_s: float) -> SourceInput:
    whole = np.ones(rows)
    return SourceInput(whole, 0.1 * whole, 9 * whole, speed_m_s * whole, arm_distance_m * whole)


def of_person(arm_distance_m: float, speed_m_s: float, person: int) -> float:
    distance, speed = (torch.tensor(each, dtype=torch.float64) for each in (arm_distance_m, speed_m_s))
    return float(rating(distance, speed, torch.tensor(person)))


# ---- the fit -------------------------------------------------------------------------------------------


def test_the_constants_are_those_of_the_fit() -> None:
    assert asdict(FITTED) == pytest.approx(asdict(fit(FIGURES)), rel=1e-4)


def test_every_figure_has_a_source_what_was_read_and_a_scope() -> None:
    for each in FIGURES.values():
        assert "https://doi.org/" in each["source"] and each["read"] and each["scope"]


def test_ratings_by_distance_and_speed_are_within_the_spread_between_persons() -> None:
    passing = FIGURES["distance_and_speed"]
    distance, speed = (torch.tensor(passing[name], dtype=torch.float64) for name in ("distance_m", "speed_m_s"))
    error = expected(distance[:, None], speed).numpy() - passing["comfort"]
    assert np.abs(error).max() < min(0.32, FITTED.spread) and np.sqrt((error**2).mean()) < 0.16


def test_surprise_and_fear_by_arm_speed_are_within_the_spread_between_persons() -> None:
    exponent, felt = arm_speed(FIGURES)
    told = np.array([FIGURES["arm_speed"][name] for name in ("surprise", "fear")])
    assert exponent == pytest.approx(FITTED.exponent, rel=1e-4)
    assert np.abs(felt - told).max() < min(0.015, FITTED.spread)


def test_the_population_has_the_spread_of_the_raters() -> None:
    assert ratings(FIGURES).person.max() + 1 == 12 and len(ratings(FIGURES).share) == 293
    assert float(offsets(EVERYONE).std()) == pytest.approx(FITTED.spread, rel=0.01)
    assert float(offsets(EVERYONE).mean()) == pytest.approx(0.0, abs=0.01)


def test_the_error_on_the_held_out_distances_is_as_told() -> None:
    found = held_out(FIGURES)
    assert found == pytest.approx({"rank_correlation": 0.82, "bias": 0.22, "rmse": 0.33}, abs=0.005)


# ---- persons -------------------------------------------------------------------------------------------


def test_splits_share_no_person_and_have_the_population_s_spread() -> None:
    shares = {split: persons_of(split) for split in (None, "validation", "test")}
    whose = {split: range(round(low * PERSONS), round(high * PERSONS)) for split, (low, high) in shares.items()}
    assert sorted(n for each in whose.values() for n in each) == list(range(PERSONS))
    assert persons_of("train") == persons_of(None) and persons_of("paper") == persons_of("validation")
    for each in whose.values():
        own = offsets(torch.tensor(list(each)))
        assert abs(float(own.mean())) < 0.02 and float(own.std()) == pytest.approx(FITTED.spread, rel=0.03)


@pytest.mark.parametrize("person", [0, 1, 500, PERSONS - 1])
def test_a_person_likes_distance_and_slowness(person: int) -> None:
    by_distance = [of_person(distance, 0.5, person) for distance in (0.0, 0.2, 0.4, 0.8, 3.0)]
    by_speed = [of_person(0.2, speed, person) for speed in (1.0, 0.5, 0.0)]
    assert by_distance == sorted(by_distance) and by_speed == sorted(by_speed)
    assert by_distance[0] < by_distance[-2] and by_speed[0] < by_speed[-1]


def test_ratings_stay_on_their_scale() -> None:
    distance = torch.tensor([-1.0, 0.0, torch.inf], dtype=torch.float64)[:, None]
    for speed in (0.0, 100.0):
        rated = rating(distance, torch.tensor(speed, dtype=torch.float64), EVERYONE)
        assert float(rated.min()) >= 1 and float(rated.max()) <= 7
    assert of_person(-1.0, 0.3, 0) == of_person(-BODY_M, 0.3, 0)


def test_the_mean_rating_of_an_episode_is_that_of_its_instants() -> None:
    rng = np.random.default_rng(0)
    tool, arm = np.cumsum(rng.normal(0, 0.01, (50, 3)), axis=0), rng.uniform(0.0, 1.0, 50)
    speed = np.linalg.norm(np.diff(tool, axis=0), axis=-1) / 0.02
    each = [of_person(distance, moving, 7) for distance, moving in zip(arm[1:], speed, strict=True)]
    assert mean_rating(arm, tool, 7) == pytest.approx(np.mean(each))


# ---- the closed loop -----------------------------------------------------------------------------------


def levels(source: Fitted, arm_distance_m: float, speed_m_s: float) -> NDArray[np.float64]:
    return source.advance(beside(len(source.level), arm_distance_m, speed_m_s))


def test_the_level_falls_near_a_fast_arm_and_rises_when_it_is_slow_or_far() -> None:
    source = begun([0, 500, PERSONS - 1])
    first = source.level.copy()
    fast, slow, far = levels(source, 0.1, 1.0), levels(source, 0.1, 0.0), levels(source, 1.5, 1.0)
    assert (fast < slow).all() and (slow < far).all() and (far == first).all()
    assert (fast >= 1).all() and (far <= 10).all()


def test_levels_are_those_of_the_ratings() -> None:
    assert level_of(torch.tensor([1.0, 4.0, 7.0]), 10).tolist() == [1, 6, 10]
    assert level_of(torch.tensor([1.0, 4.0, 7.0]), 5).tolist() == [1, 3, 5]


def test_a_person_more_at_ease_has_a_higher_level() -> None:
    order = offsets(EVERYONE).argsort()
    source = begun([int(order[0]), int(order[-1])])
    low, high = levels(source, 0.2, 0.5)
    assert low < high


def test_only_the_rows_that_begin_change() -> None:
    source = begun([3, 4])
    before = levels(source, 0.0, 1.0)
    source.begin(np.array([1]))
    assert source.level[0] == before[0] and source.level[1] > before[1]


def test_a_fitted_source_continues_from_its_state() -> None:
    first, second = begun([3, 400]), make_source(comfort(), 2)
    second.load_state_dict(first.state_dict())
    assert (levels(first, 0.1, 0.4) == second.advance(beside(2, 0.1, 0.4))).all()
