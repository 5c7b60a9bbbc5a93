"""People begin at their spawn points or round them, and are observed there or clipped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hrl_comfort import humans
from hrl_comfort.config import FAR_AWAY_M, ConfigError
from tests.humans.paper import GOALS, HUMAN, SPAWNS, discs


def test_five_spawns_of_the_authors_are_moved_out_to_the_keep_out_distance_and_no_others() -> None:
    moved = humans.moved_spawns(HUMAN, GOALS)
    shift = np.linalg.norm(moved - np.array(SPAWNS), axis=1)
    assert np.flatnonzero(shift).tolist() == [1, 3, 4, 7, 10]
    np.testing.assert_allclose(shift[[1, 3, 4, 7, 10]], [0.0333, 0.0718, 0.0198, 0.0012, 0.0718], atol=1e-4)
    assert np.linalg.norm(moved[:, None] - discs(1).centres, axis=-1).min() >= HUMAN.keep_out_m


def test_points_in_overlapping_discs_go_to_the_nearest_free_point() -> None:
    rng = np.random.default_rng(5)
    centres = rng.uniform(-0.5, 0.5, (300, 3, 2))
    points = rng.uniform(-0.6, 0.6, (300, 2))
    keep_out = humans.KeepOut(centres, 0.35)
    moved = humans.outside(points, keep_out)
    assert not keep_out.entered(moved).any()
    np.testing.assert_array_equal(moved[~keep_out.entered(points)], points[~keep_out.entered(points)])
    grid = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 201)] * 2), axis=-1).reshape(-1, 2)
    for i in range(0, 300, 10):
        free = (np.linalg.norm(grid[:, None] - centres[i], axis=-1) >= 0.351).all(axis=1)
        nearest = np.linalg.norm(grid[free] - points[i], axis=1).min()
        assert np.linalg.norm(moved[i] - points[i]) <= nearest


def test_a_point_in_the_centre_of_a_disc_moves_to_its_rim() -> None:
    keep_out = humans.KeepOut(np.zeros((1, 2, 2)), 0.35)
    assert np.linalg.norm(humans.outside(np.zeros((1, 2)), keep_out)) == pytest.approx(0.35, abs=1e-5)


def test_training_uses_every_spawn_that_is_not_held_out() -> None:
    assert humans.training_spawns(HUMAN).tolist() == [0, 1, 2, 4, 6, 8, 9, 12, 13, 15, 18]


def test_jitter_fills_its_disc_evenly() -> None:
    u = np.random.default_rng(6).random((20_000, 2))
    offset = humans.jittered_spawn(HUMAN, np.tile([2.0, 2.0], (len(u), 1)), u) - 2.0
    radius = np.linalg.norm(offset, axis=1)
    assert radius.max() <= HUMAN.spawn_jitter_m + 1e-12
    assert np.mean(radius < HUMAN.spawn_jitter_m / 2) == pytest.approx(0.25, abs=0.01)
    np.testing.assert_allclose(offset.mean(axis=0), 0.0, atol=2e-3)


def test_a_spawn_anywhere_is_in_its_ring_and_clear_of_discs_and_held_out_points() -> None:
    rng, spawns = np.random.default_rng(7), humans.moved_spawns(HUMAN, GOALS)
    chosen = replace(HUMAN, spawn="anywhere")
    places = np.stack([humans.training_spawn(chosen, spawns, discs(1), rng)[1] for _ in range(2000)])
    radius = np.linalg.norm(places, axis=1)
    assert radius.min() >= 0.38
    assert radius.max() <= 1.1
    assert not discs(2000).entered(places).any()
    to_held_out = np.linalg.norm(places[:, None] - spawns[HUMAN.held_out], axis=-1)
    assert to_held_out.min() >= HUMAN.spawn_margin_m
    quadrants = np.bincount((places[:, 0] > 0) * 2 + (places[:, 1] > 0), minlength=4)
    assert quadrants.min() > 200, "every side of the robot is visited"


@pytest.mark.parametrize(("spawn", "share"), [("points", 1.0), ("mixed", 0.5), ("anywhere", 0.0)])
def test_training_spawns_are_at_training_points_or_anywhere(spawn: str, share: float) -> None:
    rng, spawns, config = (
        np.random.default_rng(9),
        humans.moved_spawns(HUMAN, GOALS),
        replace(HUMAN, spawn=spawn),
    )
    drawn = [humans.training_spawn(config, spawns, discs(1), rng) for _ in range(1000)]
    indices = np.array([index for index, _ in drawn])
    assert np.mean(indices >= 0) == pytest.approx(share, abs=0.05)
    assert not set(indices) & set(HUMAN.held_out)
    places = np.stack([place for _, place in drawn])
    to_held_out = np.linalg.norm(places[:, None] - spawns[HUMAN.held_out], axis=-1)
    assert to_held_out.min() >= HUMAN.spawn_margin_m


def test_a_ring_without_room_is_refused_and_named() -> None:
    config = replace(HUMAN, spawn="anywhere", spawn_radius_m=[0.1, 0.2])
    with pytest.raises(ConfigError, match=r"human\.spawn_radius_m=\[0\.1, 0\.2\]"):
        humans.training_spawn(config, np.array(SPAWNS), discs(1), np.random.default_rng(8))


# ---- observed position -----------------------------------------------------------------------------------


def test_clipping_off_gives_the_true_position() -> None:
    position = np.array([[0.7, 0.1]])
    np.testing.assert_array_equal(humans.seen_position(HUMAN, position, np.array(SPAWNS)), position)


def test_full_clipping_snaps_to_the_nearest_spawn_and_partial_only_to_a_nearer_one() -> None:
    spawns = np.array([[1.0, 0.0], [0.0, 1.0]])
    position = np.array([[1.2, 0.1], [0.8, 0.1], [0.1, 1.3]])
    full = humans.seen_position(replace(HUMAN, clipping="full"), position, spawns)
    np.testing.assert_array_equal(full, [[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    partial = humans.seen_position(replace(HUMAN, clipping="partial"), position, spawns)
    np.testing.assert_array_equal(partial, [[1.0, 0.0], [0.8, 0.1], [0.0, 1.0]])


@pytest.mark.parametrize("clipping", ["off", "full", "partial"])
def test_an_absent_human_is_observed_far_away(clipping: str) -> None:
    config = replace(HUMAN, clipping=clipping, motion="none")
    position = humans.begin(config, np.array([[0.9, 0.3], [0.5, 0.5]])).position
    seen = humans.seen_position(config, position, np.array(SPAWNS))
    np.testing.assert_array_equal(seen, [[FAR_AWAY_M, 0.0]] * 2)
