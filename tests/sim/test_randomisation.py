"""Cells differ from the model as drawn, the same in every front, batch and continuation."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hrl_comfort.composition.compose import compose
from hrl_comfort.composition.stages import stages_of
from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.envs.dm import make_environment
from hrl_comfort.files.run_config import environment
from hrl_comfort.safety.allowances import LARGEST_NOISE, MOST_LOST
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.variation.random_streams import random_stream
from hrl_comfort.sim.variation.randomisation import Servos, Values, draws
from hrl_comfort.sim.variation.tracker import Tracker

ALL = "randomise=sim_to_real"
SHIELDED = (
    "robot.rating=collaborative", "safety=ssm", "safety.bound=worst", "safety.lag_s=0.23", "safety.latency_s=0.2",
    "safety.delay_s=0.3", "safety.margin_m=0.09",
)  # fmt: skip


def config(*overrides: str) -> EnvConfig:
    return environment(compose("train", ["task=pick", *overrides]))


def actions(count: int, rows: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (count, rows, 6))


def values_of(world: np.ndarray, *overrides: str) -> Values:
    return Values(config(*overrides).randomise, world)


@pytest.mark.parametrize("key", [(0, 0), (3, 5), (850_000 << 32, (42 << 48) + 7), (2**64 - 1, 2**64 - 1)])
def test_a_random_stream_is_that_of_numpy_with_the_same_key(key: tuple[int, int]) -> None:
    theirs = np.random.Generator(np.random.Philox(key=np.array(key, dtype=np.uint64)))
    np.testing.assert_array_equal(random_stream(*key).random(9), theirs.random(9))


@pytest.mark.parametrize("world", [(), SHIELDED])
def test_the_dm_control_front_and_the_engine_agree(world: tuple[str, ...]) -> None:
    asked = config(*world, ALL, "human=approach")
    env, engine = make_environment(asked, 3), Engine(asked, 1, 3)
    engine.reset()
    step = env.reset()
    for action in actions(6, 1):
        seen = np.concatenate([np.ravel(each) for each in step.observation.values()])
        np.testing.assert_allclose(seen, engine.episodes.observe()[0], atol=1e-9)
        if step.last():
            break
        step = env.step(action[0])
        engine.step(action)


def test_an_episode_does_not_depend_on_its_batch() -> None:
    alone, beside = Engine(config(ALL), 1, 0), Engine(config(ALL), 3, 0)
    alone.reset()
    beside.reset()
    for action in actions(5, 3):
        one, many = alone.step(action[:1]).state, beside.step(action).state
        assert torch.equal(one.joint_pos[0], many.joint_pos[0]) and torch.equal(one.humans_seen[0], many.humans_seen[0])


@pytest.mark.parametrize("world", [(), SHIELDED])
def test_a_loaded_engine_goes_on_bit_for_bit(world: tuple[str, ...]) -> None:
    asked = config(*world, ALL, "human=approach")
    one, other = Engine(asked, 4, 0), Engine(asked, 4, 0)
    one.reset()
    steps = actions(10, 4)
    for action in steps[:4]:
        one.step(action)
    other.load_state_dict(one.state_dict())
    for action in steps[4:]:
        ours, theirs = one.step(action), other.step(action)
        assert torch.equal(one.episodes.observe(), other.episodes.observe())
        assert torch.equal(ours.state.joint_pos, theirs.state.joint_pos)
        done = np.flatnonzero(ours.done.numpy())
        one.reset(done)
        other.reset(done)


def test_episodes_draw_different_cells_and_nothing_else_changes() -> None:
    plain, other = Engine(config(), 8, 0), Engine(config(ALL), 8, 0)
    first, second = plain.reset(), other.reset()
    for name in ("joint_pos", "humans_pos", "objects", "kinds"):
        assert torch.equal(getattr(first, name), getattr(second, name))
    lags = other.episodes.values().of("servo_lag_s")
    assert len(set(lags.tolist())) == 8 and (lags >= 0).all() and (lags <= 0.2).all()
    other.reset()
    assert not set(lags.tolist()) & set(other.episodes.values().of("servo_lag_s").tolist())


def test_set_points_are_behind_a_ramp_by_lag_and_latency() -> None:
    asked = config("randomise.servo_lag_s=[0.08,0.08]", "randomise.latency_s=[0.053,0.053]").randomise
    servos = Servos(asked, 2, 6, 2)
    rate = np.array([0.5, -1.0])[:, None]
    servos.begin(np.arange(2), Values(asked, np.zeros((2, 20))), np.zeros((2, 6)))
    for decision in range(20):
        times = 0.01 * (10 * decision + 1 + np.arange(10))
        servos.begin_decision()
        reached = servos.follow(np.repeat((rate * times)[..., None], 6, axis=2))
        servos.end_decision(np.array([4, 4]))
    np.testing.assert_allclose(reached[:, -1], rate * (times[-1] - 0.133) * np.ones((1, 6)), atol=1e-6)


def test_a_decision_that_ends_early_goes_on_from_where_it_ended() -> None:
    asked = config("randomise=servo").randomise
    world = np.random.default_rng(0).random((1, 20))
    whole, cut = Servos(asked, 1, 6, 2), Servos(asked, 1, 6, 2)
    path = np.cumsum(np.random.default_rng(1).normal(size=(1, 16, 6)), axis=1)
    for each in (whole, cut):
        each.begin(np.arange(1), Values(asked, world), np.zeros((1, 6)))
    through = whole.follow(path)
    cut.follow(np.concatenate([path[:, :6], np.full((1, 4, 6), 9.0)], axis=1))
    cut.end_decision(np.array([2]))
    np.testing.assert_allclose(cut.follow(path[:, 6:]), through[:, 6:])


def test_an_arm_with_lag_follows_later() -> None:
    push = np.ones((3, 6)) * 0.5
    way = []
    for overrides in ((), ("randomise.servo_lag_s=[0.2,0.2]",), ("randomise.latency_s=[0.1,0.1]",)):
        engine = Engine(config("human=none", *overrides), 3, 0)
        start = engine.reset().joint_pos
        way.append(float((engine.step(push).state.joint_pos - start).norm()))
    assert way[1] < 0.7 * way[0] and way[2] < 0.2 * way[0]


def test_joints_are_observed_with_noise_and_rewarded_without() -> None:
    asked = ("randomise.joint_noise_deg=[2,2]", "randomise.joint_velocity_noise_deg_s=[10,10]")
    plain, noisy = Engine(config(), 64, 0), Engine(config(*asked), 64, 0)
    plain.reset()
    noisy.reset()
    action = actions(1, 64)[0]
    one, other = plain.step(action), noisy.step(action)
    assert torch.equal(one.reward, other.reward) and torch.equal(one.state.joint_pos, other.state.joint_pos)
    seen = noisy.episodes.observed(other.state)
    error = torch.rad2deg(seen.joint_pos - other.state.joint_pos)
    assert 1.6 < float(error.std()) < 2.4 and float(error.abs().max()) <= 2 * LARGEST_NOISE + 1e-9
    assert 8 < float(torch.rad2deg(seen.joint_vel - other.state.joint_vel).std()) < 12
    assert not torch.equal(seen.tcp_pos, other.state.tcp_pos)
    assert plain.episodes.observed(one.state) is one.state


def test_the_tracker_holds_its_frames_and_loses_two_in_a_row_at_most() -> None:
    asked = config("randomise.person_rate_hz=[20,20]", "randomise.person_dropout=[0.9,0.9]").randomise
    rng = np.random.default_rng(0)
    world, _, frames = draws(asked, 6, rng)
    tracker, place, limbs = Tracker(asked, 1), np.zeros((1, 1, 2)), np.zeros((1, 7, 7))
    tracker.begin(np.zeros(1, dtype=np.int64), Values(asked, world[None]), frames[None], place, limbs)
    tracker.begin_decision()
    ages = []
    for step in range(1, 500):
        here = np.full((1, 1, 2), float(step))
        tracker.see(np.array([step]), frames[None], here, np.full((1, 7, 7), float(step)))
        ages.append(step - tracker.seen()[0, -1, 0, 0])
        assert tracker.shown[0, 0, 0] == tracker.seen()[0, -1, 0, 0]
    assert 5 <= max(ages) <= (1 + MOST_LOST) / 20 / 0.02
    assert ages.count(0) > 50


def test_the_persons_position_is_noisy_up_to_three_deviations() -> None:
    engine = Engine(config("human=still", "randomise.person_noise_m=[0.05,0.05]"), 32, 0)
    engine.reset()
    error = []
    for action in actions(6, 32):
        state = engine.step(0.1 * action).state
        error.append((state.humans_seen - state.humans_pos).numpy())
    length = np.linalg.norm(error, axis=-1)
    assert 0.04 < np.std(error) < 0.06 and length.max() <= 0.15 + 1e-9 and len(np.unique(length)) > 150


def test_links_differ_in_mass_and_friction() -> None:
    engine = Engine(config("randomise.link_mass=[0.5,1.5]", "randomise.joint_friction=[0.1,0.2]"), 2, 0)
    engine.reset()
    nominal = engine.scene.model
    factors = []
    for model in engine.physics.models:
        moving = nominal.body_weldid > 0
        moving &= nominal.body_mass > 0
        factors.append(model.body_mass[moving] / nominal.body_mass[moving])
        assert (model.dof_frictionloss >= 0.1 * nominal.actuator_forcerange[:, 1] - 1e-9).all()
    assert not np.allclose(*factors) and (np.array(factors) > 0.49).all() and (np.array(factors) < 1.51).all()
    assert nominal.dof_frictionloss.max() == 0
    assert (engine.step(actions(1, 2)[0]).state.joint_vel.abs() < 10).all()


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (("randomise=servo",), r"safety\.lag_s=0\.23 safety\.latency_s=0\.2"),
        (("randomise.person_rate_hz=[10,30]",), r"safety\.delay_s=0\.1 safety\.bound=worst"),
        (("randomise.person_noise_m=[0,0.03]", "safety.bound=worst"), r"safety\.margin_m=0\.09"),
    ],
)
def test_the_shield_must_allow_for_it(overrides: tuple[str, ...], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        Engine(config("robot.rating=collaborative", "safety=ssm", *overrides), 1, 0)


def test_behind_a_shield_that_allows_for_it_no_contact_is_fast() -> None:
    world = (
        *SHIELDED, ALL, "task=pick_place", "human=adversary", "human.keep_out_m=0", "human.spawn=anywhere",
        "human.spawn_radius_m=[0.8,1.8]", "task.terminate_on=contact",
    )  # fmt: skip
    engine, rng, found = Engine(config(*world), 64, 0), np.random.default_rng(0), np.zeros(2, dtype=int)
    engine.reset()
    for _ in range(160):
        result = engine.step(rng.uniform(-1.0, 1.0, (64, 6)))
        found += [int((flag & result.done).sum()) for flag in (result.state.contact, result.state.unsafe_contact)]
        engine.reset(np.flatnonzero(result.done.numpy()))
    assert found[0] > 50 and found[1] == 0


def test_a_stage_sets_it() -> None:
    stages = "[{name:plain,policy_steps:10},{name:late,policy_steps:10,set:{randomise.latency_s:[0,0.1]}}]"
    found = [each.randomise for _, each in stages_of(compose("train", [f"curriculum.stages={stages}"]))]
    assert [each.latency_s for each in found] == [[0, 0], [0, 0.1]]
    assert [each.differs for each in found] == [False, True]


def test_an_arm_is_not_randomised() -> None:
    with pytest.raises(ConfigError, match="randomise= is for simulated cells"):
        compose("deploy", ["policy=expert", ALL])


def test_a_range_is_from_low_to_high() -> None:
    with pytest.raises(ConfigError, match=r"randomise\.latency_s=\[0\.2, 0\.1\]"):
        compose("train", ["randomise.latency_s=[0.2,0.1]"])
