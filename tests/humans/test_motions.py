"""Bounds of every motion, and what the people who live in the cell do."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from hrl_comfort import humans
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import CONTROL_STEP_S, ConfigError, HumanConfig
from hrl_comfort.config.overrides import choices
from hrl_comfort.files.run_config import environment
from hrl_comfort.humans.body import ARM_LENGTH_M, FOREARM_M, UPPER_ARM_M
from hrl_comfort.humans.motions.kernels import social_force
from hrl_comfort.scene.human import limb_poses
from hrl_comfort.sim.engine import Engine
from tests.humans.around import STATIONS, around

OWN = Path(__file__).with_name("reach.bvh")
GOALS = np.array([[-0.615, -0.070], [0.647, -0.055], [0.126, 0.453]])
PEOPLE, STEPS = 48, 1000
LIVELY = ("patrol", "worker", "reactive", "fetcher", "adversary")


@cache
def human(name: str, *overrides: str) -> HumanConfig:
    file = [f"human.file={OWN}"] if name == "recorded" else []
    return compose("train", [f"human={name}", *file, *overrides]).human


def waving(step: int) -> humans.ArmSource:
    """Return an arm of two points that sweeps round the base at 1 m/s."""
    angle = step * CONTROL_STEP_S * 2 + np.arange(PEOPLE)
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)[:, None] * np.array([[0.25], [0.5]])
    across = np.stack([-out[..., 1], out[..., 0], 0 * out[..., 0]], axis=-1)
    return lambda: (out, 2 * across)


@cache
def strolled(config_name: str, *overrides: str) -> list[humans.Walk]:
    """Return PEOPLE walks after each of STEPS control steps beside the waving arm."""
    config, rng = human(config_name, *overrides), np.random.default_rng(0)
    keep_out = humans.around(GOALS, config.keep_out_m, PEOPLE)
    bearing, radius = rng.uniform(-np.pi, np.pi, PEOPLE), rng.uniform(0.6, 1.6, (PEOPLE, 1))
    spawn = humans.outside(radius * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1), keep_out)
    walks = [humans.begin(config, spawn, rng.random((PEOPLE, humans.TRAITS)))]
    for step in range(STEPS):
        noise, arm = rng.random((PEOPLE, humans.NOISE)), waving(step)
        walks.append(humans.advance(config, walks[-1], noise, around(arm()[0][:, -1, :2], keep_out, arm)))
    return walks


def stacked(walks: list[humans.Walk], name: str) -> np.ndarray:
    return np.stack([getattr(walk, name) for walk in walks])


def poses(walks: list[humans.Walk]) -> np.ndarray:
    """Return (T, PEOPLE, 7, 7)."""
    return np.stack([limb_poses(*w.position.T, w.yaw, *humans.gait(w), 0.0, w.limbs) for w in walks])


def hands(walks: list[humans.Walk]) -> np.ndarray:
    """Return the centres of the fists (T, PEOPLE, 2, 3) m."""
    pose = poses(walks)[..., 5:, :]
    w, x, y, z = np.moveaxis(pose[..., 3:], -1, 0)
    down = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)
    return pose[..., :3] - FOREARM_M * down


@pytest.mark.parametrize("name", choices("human"))
def test_every_motion_keeps_to_its_bounds(name: str) -> None:
    velocity = np.diff(stacked(strolled(name), "position"), axis=0) / CONTROL_STEP_S
    acceleration = np.diff(velocity, axis=0) / CONTROL_STEP_S
    speed, change = humans.bounds(human(name))
    assert speed < 3.0, "people do not run"
    assert np.linalg.norm(velocity, axis=-1).max() <= speed + 1e-6
    assert np.linalg.norm(acceleration, axis=-1).max() <= change + 1e-6


@pytest.mark.parametrize("name", LIVELY)
def test_people_who_live_there_start_at_rest_and_use_their_speed(name: str) -> None:
    walks, config = strolled(name), human(name)
    velocity = np.diff(stacked(walks, "position"), axis=0) / CONTROL_STEP_S
    assert config.acceleration_m_s2 is not None
    assert np.linalg.norm(velocity[0], axis=-1).max() <= config.acceleration_m_s2 * CONTROL_STEP_S + 1e-9
    assert np.linalg.norm(velocity, axis=-1).max() > 0.9 * config.speed_m_s


@pytest.mark.parametrize("name", LIVELY)
def test_limbs_of_people_who_live_there_hang_together_and_never_jump(name: str) -> None:
    walks = strolled(name)
    pose = poses(walks)
    np.testing.assert_allclose(np.linalg.norm(pose[..., 3:], axis=-1), 1.0, atol=1e-9)
    apart = np.linalg.norm(pose[..., 5:, :3] - pose[..., 3:5, :3], axis=-1)
    np.testing.assert_allclose(apart, UPPER_ARM_M, atol=1e-9)
    fastest = np.linalg.norm(np.diff(hands(walks), axis=0), axis=-1).max() / CONTROL_STEP_S
    assert fastest <= (human(name).speed_m_s + 1e-6 if name == "adversary" else 2.0)


@pytest.mark.parametrize("name", ["patrol", "worker", "reactive", "fetcher"])
def test_they_walk_round_the_discs_without_being_cut_at_them(name: str) -> None:
    position = stacked(strolled(name), "position")
    discs = humans.around(GOALS, human(name).keep_out_m, PEOPLE).centres
    assert np.linalg.norm(position[:, :, None] - discs, axis=-1).min() >= human(name).keep_out_m - 0.01
    assert np.linalg.norm(position, axis=-1).max() < 2.5


def test_a_fetcher_goes_round_the_stations_by_habit_and_reaches_into_each() -> None:
    walks = strolled("fetcher")
    memory, hand, stations = stacked(walks, "memory"), hands(walks), np.array(STATIONS)
    number, clock, stay = (memory[1:, :, index] for index in range(3))
    left = (number[1:] != number[:-1]).nonzero()
    assert len(left[0]) > PEOPLE, "most people have left a station"
    assert (clock[:-1][left] >= stay[:-1][left]).all()
    assert ((stay[:-1][left] >= 0.8 * 6.0) & (stay[:-1][left] <= 1.2 * 6.0)).all()
    way = (number[1:] - number[:-1])[left] % len(stations) == 1
    own = walks[0].traits[left[1], 2] < 0.5
    assert 0.8 < (way == own).mean() < 1.0, "in their own direction, but for a few"
    working = (clock > 1.5) & (clock < stay - 1.5)
    at = stations[number.astype(int) - 1]
    apart = np.linalg.norm(stacked(walks[1:], "position") - at, axis=-1)
    assert apart[working].max() < 0.1
    table = at * (1 - 0.4 / np.linalg.norm(at, axis=-1, keepdims=True))
    assert np.linalg.norm(hand[1:, ..., :2] - table[:, :, None], axis=-1)[working].max() < 0.2


def test_the_worker_reaches_with_both_hands_to_where_the_objects_lie() -> None:
    walks = strolled("worker")
    hand = hands(walks)
    stations = np.array(STATIONS)
    nearest = np.linalg.norm(walks[0].position[:, None] - stations, axis=-1).argmin(axis=1)
    arrived = stacked(walks[-300:], "position")
    assert np.linalg.norm(arrived - stations[nearest], axis=-1).max() < 0.05
    # Both hands are within a hand's breadth of an object's place, and away again.
    to_objects = np.linalg.norm(hand[..., None, :2] - GOALS, axis=-1).min(axis=-1)[-300:]
    assert to_objects.min(axis=0).max() < 0.15
    assert to_objects.max(axis=0).min() > 0.15
    assert (hand[..., 2] > 0.9).all()
    shoulders = poses(walks)[..., 3:5, :3]
    assert np.linalg.norm(hand - shoulders, axis=-1).max() <= ARM_LENGTH_M


def test_patrol_turns_to_the_next_table_and_pauses_there() -> None:
    walks = strolled("patrol")
    position, yaw = stacked(walks, "position"), np.unwrap(stacked(walks, "yaw"), axis=0)
    stations = np.array(STATIONS)
    at = np.linalg.norm(position[:, :, None] - stations, axis=-1) < 0.1
    assert (at.any(axis=0).sum(axis=-1) >= 2).mean() > 0.8, "most visit two tables or more in 20 s"
    assert np.abs(np.diff(yaw, axis=0)).max() <= 1.6 * CONTROL_STEP_S + 1e-9


def test_the_adversary_reaches_the_arm_from_wherever_it_starts() -> None:
    gap = [
        np.linalg.norm(waving(step)()[0][..., :2] - walk.position[:, None], axis=-1).min(axis=1)
        for step, walk in enumerate(strolled("adversary"))
    ]
    assert np.min(gap, axis=0).max() < 0.1


# Differences of position (m) and velocity (m/s) of two people, and the social force (m/s²) on the first, of
# `pysocialforce.forces.SocialForce` of PySocialForce 1.1.2 with its default parameters and factor 5.1.
ORACLE = np.array(
    [
        [0.22, 0.07, -1.13, -0.43, 5.2944530879, -2.5156114723],
        [0.29, 0.61, -1.28, -1.96, -1.3054517674, 3.5651467050],
        [0.36, 0.08, -0.14, -0.32, 2.6785953982, -0.7943308474],
        [-1.28, 1.02, 1.85, -1.03, -0.2029849631, 2.0356085837],
        [0.23, 0.06, 0.34, -0.04, 1.4538176836, 0.0737302148],
        [0.95, -0.56, -0.99, 0.02, 0.3708572353, -1.1528599272],
        [-0.37, 0.02, -0.25, -0.55, -0.8804204469, -0.0995352689],
        [0.86, -0.91, -0.12, 0.28, 0.7217068082, -0.1072863858],
        [-1.68, -0.22, 0.51, 0.16, -0.5622318828, 0.3650531009],
        [0.12, -0.90, -0.17, -0.06, -0.1533285803, -0.4497268093],
    ]
)


def test_the_social_force_is_that_of_pysocialforce() -> None:
    for *given, x, y in ORACLE:
        np.testing.assert_allclose(social_force(*given)[:2], (x, y), atol=1e-9)


def test_the_afraid_keep_farther_from_the_arm_than_the_curious() -> None:
    def mean_distance(curiosity: float) -> float:
        walks = strolled("reactive", f"human.curiosity={curiosity}")
        return float(np.linalg.norm(stacked(walks[300:], "position"), axis=-1).mean())

    afraid, neutral, curious = map(mean_distance, (0.0, 0.5, 1.0))
    assert afraid > neutral > curious


def test_a_motion_can_be_left_out_of_a_mixture() -> None:
    config = compose("train", ["human=mixture", "~human.mixture.approach"]).human
    assert [person.motion for person in config.people] == ["random_walk", "patrol", "worker", "reactive"]
    with pytest.raises(ConfigError, match=r"~human.motion deletes a key; every key needs a value"):
        compose("train", ["~human.motion"])


def test_a_mixture_draws_each_of_its_motions_equally_often() -> None:
    config = human("mixture")
    assert [person.motion for person in config.people] == list(config.mixture)
    walks = strolled("mixture")
    chosen = (walks[0].traits[:, 0] * len(config.people)).astype(int)
    assert np.bincount(chosen, minlength=len(config.people)).min() > 0
    alone = human("mixture").people[3]
    assert (alone.motion, alone.speed_m_s, alone.keep_out_m) == ("worker", 1.2, config.keep_out_m)
    stations = np.array(STATIONS)
    last = walks[-1].position[chosen == 3]
    assert np.linalg.norm(last[:, None] - stations, axis=-1).min(axis=1).max() < 0.05


@pytest.mark.parametrize(
    ("overrides", "says"),
    [
        (["human=still", "human.motion=mixture"], r"human\.mixture=\[\]"),
        (["human=still", "+human.mixture.still={}"], r"no other motion"),
        (["human=mixture", "+human.mixture.worker.walking=1"], r"human\.mixture\.worker\.walking"),
        (["human=mixture", "human.mixture.worker.speed_m_s=9"], r"human\.mixture\.worker.*speed_m_s"),
        (["human=adversary", "human.acceleration_m_s2=null"], r"acceleration_m_s2=null"),
        (["human=recorded"], r"human\.file=null"),
        (["human=mixture", "+human.mixture.none={}"], r"human\.mixture\.none: nobody has no distance"),
    ],
)
def test_what_does_not_go_together_is_refused(overrides: list[str], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        compose("train", overrides)


def test_a_mixture_runs_in_the_engine_and_goes_on_bit_for_bit() -> None:
    config = environment(compose("train", ["task=pick", "human=mixture"]))
    engines = [Engine(config, 6, 0) for _ in range(2)]
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (12, 6, 6))
    for engine in engines:
        engine.reset()
    for action in actions[:6]:
        engines[0].step(action)
    engines[1].load_state_dict(engines[0].state_dict())
    for action in actions[6:]:
        results = [engine.step(action) for engine in engines]
        assert (results[0].state.humans_pos == results[1].state.humans_pos).all()
    for engine in engines:
        engine.close()


def test_people_of_a_mixture_walk_as_they_would_alone() -> None:
    config, rng = human("mixture"), np.random.default_rng(0)
    keep_out = humans.around(GOALS, config.keep_out_m, PEOPLE)
    spawn = humans.outside(rng.uniform(-1.5, 1.5, (PEOPLE, 2)), keep_out)
    walk = humans.begin(config, spawn, rng.random((PEOPLE, humans.TRAITS)))
    alone = [walk] * len(config.people)
    chosen = (walk.traits[:, 0] * len(config.people)).astype(int)
    for step in range(200):
        noise, arm = rng.random((PEOPLE, humans.NOISE)), waving(step)
        seen = around(arm()[0][:, -1, :2], keep_out, arm)
        walk = humans.advance(config, walk, noise, seen)
        alone = [humans.advance(*pair, noise, seen) for pair in zip(config.people, alone, strict=True)]
        for index, other in enumerate(alone):
            rows = np.flatnonzero(chosen == index)
            for name, value in vars(walk.rows(rows)).items():
                np.testing.assert_array_equal(value, getattr(other.rows(rows), name))
