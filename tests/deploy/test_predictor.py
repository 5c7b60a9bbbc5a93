"""The predicted state is that of an arm without latency; the way to the start goes around what is in it."""

from __future__ import annotations

import io
import os
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.deploy.arms import SimulatedArm
from hrl_comfort.deploy.links import Lockstep
from hrl_comfort.deploy.predictor import Predictor
from hrl_comfort.deploy.robot import RobotEngine
from hrl_comfort.deploy.stops import StoppedError
from hrl_comfort.deploy.streamer import TICKS, Streamer
from hrl_comfort.evaluation.ledger import open_split
from hrl_comfort.files.run_config import environment
from hrl_comfort.scene.servos import SERVO_LAG_S
from tests.deploy.campaign import LATENCY_S, LateArm, config
from tests.deploy.test_streamer import limits, scene


def test_the_prediction_is_the_state_of_an_arm_without_latency() -> None:
    home, rating, rng = scene().home, limits().rating, np.random.default_rng(0)
    stream = Streamer(LateArm(scene().model, home, 0), limits(), io.BytesIO())
    predictor, twin = Predictor(SERVO_LAG_S, 2 * LATENCY_S, home), SimulatedArm(scene().model, home)
    asked, late, off, slow, slipping = np.zeros(6), [], [], [], []
    for step in range(200):
        asked = rng.uniform(-0.6, 0.6, 6) if step % 10 == 0 else asked
        before, velocity = stream.point, rating.follow(stream.velocity[None], asked[None])[0]
        stream.begin_step(stream.point + velocity * CONTROL_STEP_S)
        report = stream.report()
        predictor.follow(report.point)
        predicted = predictor.ahead(report.reading)
        for tick in range(TICKS):
            stream.tick(tick)
            twin.send(before + (report.point - before) * (tick + 1) / TICKS)
        true = twin.read()
        late.append(np.abs(report.reading.angles - true.angles).max())
        off.append(np.abs(predicted.angles - true.angles).max())
        slow.append(np.abs(report.reading.velocity - true.velocity).max())
        slipping.append(np.abs(predicted.velocity - true.velocity).max())
    assert np.degrees(max(late)) > 2.0 and np.degrees(max(off)) < 0.7
    assert np.mean(off) < np.mean(late) / 6 and np.mean(slipping) < np.mean(slow) / 3


def engine_at(angles: np.ndarray) -> RobotEngine:
    """Return an engine whose arm stands at joint angles (6,) rad."""
    asked = config(1)
    link = Lockstep(partial(SimulatedArm, scene().model, angles), limits(), Path(os.devnull))
    return RobotEngine(environment(asked), link, open_split(asked).entries, lambda: False, endure=False)


def test_the_way_to_the_start_goes_by_home_where_the_straight_one_is_not_free() -> None:
    engine, rng = engine_at(scene().home), np.random.default_rng(0)
    poses = scene().home + rng.uniform(-1.5, 1.5, (4000, 6))
    for begin, end in zip(poses[::2], poses[1::2], strict=True):
        if engine._touched(begin, end) and not engine._touched(begin, scene().home) + engine._touched(
            scene().home, end
        ):
            break
    else:
        pytest.fail("no such pair of poses")
    engine.close()
    engine = engine_at(begin)
    way = engine._way(end)
    assert len(way) == 2 and (way[0] == scene().home).all() and (way[1] == end).all()
    engine.close()


def test_a_way_that_is_not_free_is_one_line() -> None:
    low = scene().home.copy()
    low[1] += np.pi / 2  # the arm lies in the table
    engine = engine_at(low)
    with pytest.raises(StoppedError, match=r"the way from \[.*\] degrees to the start would touch the table: move"):
        engine._way(scene().home)
    engine.close()
