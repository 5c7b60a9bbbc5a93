"""Set-points keep to the rating whatever is asked for, and come to rest at every stop."""

from __future__ import annotations

import io
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import CONTROL_STEP_S, DeployConfig, RobotConfig
from hrl_comfort.deploy.arms import PERIOD_S, SimulatedArm
from hrl_comfort.deploy.streamer import COLUMNS, TICKS, Limits, Streamer
from hrl_comfort.scene.workcell import Scene, build_scene
from tests.deploy.faulty_arm import FaultyArm

Array = NDArray[np.float64]


@cache
def scene() -> Scene:
    return build_scene(RobotConfig("ur3e", None, "collaborative"), compose("deploy", ["policy=expert"]).cell, 10)  # type: ignore[union-attr]


def limits() -> Limits:
    asked = compose("deploy", ["policy=expert"])
    assert isinstance(asked, DeployConfig)
    return Limits.of(asked, scene())


def streamer(fault: str = "none", at: int = 10**9) -> tuple[Streamer, io.BytesIO]:
    log = io.BytesIO()
    return Streamer(FaultyArm(scene().model, scene().home, fault, at), limits(), log), log


def run(stream: Streamer, target: Array | None, late: bool = False) -> None:
    stream.begin_step(target, late)
    for number in range(TICKS):
        stream.tick(number)


def shares(log: io.BytesIO) -> tuple[float, float]:
    """Return the largest share of the rated speed and acceleration in the log."""
    joints = len(scene().home)
    rows = np.frombuffer(log.getvalue()).reshape(-1, len(COLUMNS) + 2 * joints)
    sent = np.vstack([scene().home[None].repeat(2, axis=0), rows[:, len(COLUMNS) : len(COLUMNS) + joints]])
    speed = np.diff(sent, axis=0) / PERIOD_S
    rating = limits().rating
    acceleration = np.diff(speed, axis=0) / PERIOD_S / rating.acceleration_rad_s2
    return float((np.abs(speed) / rating.speed_rad_s).max()), float(np.abs(acceleration).max())


def push(stream: Streamer, steps: int, seed: int = 0) -> None:
    """Follow random velocities within the rating for some control steps."""
    rng, rating = np.random.default_rng(seed), limits().rating
    for _ in range(steps):
        asked = rng.uniform(-0.3, 0.3, len(scene().home))
        velocity = rating.follow(stream.velocity[None], asked[None])[0]
        run(stream, stream.point + velocity * CONTROL_STEP_S)


def test_set_points_between_control_steps_keep_to_the_rating() -> None:
    stream, log = streamer()
    push(stream, 100)
    speed, acceleration = shares(log)
    assert not stream.stopped
    assert speed < 0.3 and 0.5 < acceleration <= 1 + 1e-6


@pytest.mark.parametrize("broken", ["jump", "speed", "range", "nan"])
def test_a_set_point_that_would_break_a_limit_is_not_sent(broken: str) -> None:
    stream, log = streamer()
    push(stream, 20)
    target = stream.point + stream.velocity * CONTROL_STEP_S
    target[0] += {"jump": 0.1, "speed": 0.05, "range": 10.0, "nan": np.nan}[broken]
    for _ in range(40):
        run(stream, target)
    assert stream.stopped.startswith("limit: the next set-point has ")
    assert stream.report().at_rest
    assert max(shares(log)) <= 1 + 1e-6


@pytest.mark.parametrize("fault", ["protective stop", "emergency stop", "connection"])
def test_a_robot_that_stops_or_is_lost_stops_the_set_points(fault: str) -> None:
    stream, log = streamer(fault, 55)
    push(stream, 20)
    assert stream.stopped == {"connection": "lost connection: no answer"}.get(fault, fault)
    assert stream.report().at_rest
    assert max(shares(log)) <= 1 + 1e-6


def test_one_late_control_step_brakes_and_two_in_a_row_stop() -> None:
    stream, log = streamer()
    push(stream, 20)
    fast = np.abs(stream.velocity).max()
    run(stream, None, late=True)
    assert not stream.stopped and 0 < np.abs(stream.velocity).max() < fast
    push(stream, 5)
    run(stream, None, late=True)
    run(stream, None, late=True)
    assert stream.stopped.startswith("late cycle: ")
    for _ in range(20):
        run(stream, None)
    assert stream.report().at_rest and max(shares(log)) <= 1 + 1e-6


def test_a_stop_takes_the_rated_time() -> None:
    stream, _ = streamer()
    push(stream, 20)
    needed = float(limits().rating.stopping_time(stream.velocity[None])[0])
    stream.begin_step(None)
    stream.stop("because")
    ticks = 0
    while not stream.report().at_rest:
        stream.tick(ticks % TICKS)
        ticks += 1
    assert needed - PERIOD_S < ticks * PERIOD_S < needed + 3 * PERIOD_S


@pytest.mark.parametrize("kind", ["asked for", "limit", "late", "protective stop", "emergency stop", "connection"])
def test_every_stop_at_any_moment_comes_to_rest_in_the_rated_time(kind: str) -> None:
    for seed in range(50):
        rng = np.random.default_rng(seed)
        steps, tick = int(rng.integers(4, 9)), int(rng.integers(TICKS))
        stream, log = streamer(kind, 10 * steps + tick)
        push(stream, steps, seed)
        if kind == "late":
            run(stream, None, late=True)
        target = stream.point + stream.velocity * CONTROL_STEP_S
        stream.begin_step(target + (9.0 if kind == "limit" else 0.0), late=kind == "late")
        needed = float(
            limits().rating.stopping_time(np.maximum(np.abs(stream.velocity), np.abs(stream._speed))[None])[0]
        )
        passed, at_rest_s = 0, None
        while at_rest_s is None or passed * PERIOD_S < at_rest_s + 0.3:
            if passed == tick and kind == "asked for":
                stream.stop("asked for")
            stream.tick(min(passed, TICKS - 1))
            passed += 1
            if stream.stopped and at_rest_s is None and stream.report().at_rest:
                at_rest_s = passed * PERIOD_S
        assert at_rest_s is not None and "\n" not in stream.stopped
        assert at_rest_s <= needed + (tick + 3) * PERIOD_S
        assert max(shares(log)) <= 1 + 1e-6
        assert kind == "connection" or np.abs(stream.arm.read().velocity).max() < 0.02


def test_the_simulated_arm_follows() -> None:
    arm = SimulatedArm(scene().model, scene().home)
    for _ in range(200):
        arm.send(scene().home + 0.05)
    assert np.abs(arm.read().angles - scene().home - 0.05).max() < 2e-3


def test_an_arm_that_is_held_is_stopped_before_a_joint_is_far_from_its_set_point() -> None:
    (stream, log), rating = streamer("held", 5), limits().rating
    for _ in range(100):
        velocity = rating.follow(stream.velocity[None], 0.1 * rating.speed_rad_s[None])[0]
        run(stream, stream.point + velocity * CONTROL_STEP_S)
    assert stream.stopped.startswith("following error: joint ")
    rows = np.frombuffer(log.getvalue()).reshape(-1, len(COLUMNS) + 12)
    error = np.abs(rows[:, len(COLUMNS) : len(COLUMNS) + 6] - rows[:, len(COLUMNS) + 6 :])
    assert (error / limits().following).max() < 2.0
