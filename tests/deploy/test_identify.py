"""Lag and latency of servos are found again in logs made with known ones."""

import json
from functools import partial
from itertools import count
from unittest.mock import patch

import numpy as np
import pytest
from pandas import DataFrame

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError
from hrl_comfort.deploy.arms import PERIOD_S, SimulatedArm
from hrl_comfort.deploy.identify import identify
from hrl_comfort.deploy.links import Lockstep
from hrl_comfort.deploy.runner import Run
from hrl_comfort.deploy.streamer import Limits
from hrl_comfort.scene.servos import SERVO_LAG_S
from hrl_comfort.scene.workcell import build_scene
from tests.deploy.campaign import LATENCY_S, LateArm
from tests.deploy.campaign import config as campaign

FINE_S = 1e-4
NAMES = ("time_s", "late_s", "step", "tick", "planned")


def motion(times, joint):
    """Return a smooth motion (n,) rad, at up to 1.2 rad/s."""
    return 0.5 * np.sin(1.3 * times + joint) + 0.25 * np.sin(2.9 * times)


def lagging(times, joint, lag_s, latency_s):
    """Return the motion (n,) rad behind a delay and a first-order lag, integrated in steps of FINE_S."""
    fine = np.arange(0.0, times[-1] + FINE_S, FINE_S)
    asked, found = motion(fine - latency_s, joint), np.empty_like(fine)
    value = asked[0]
    for index, each in enumerate(asked):
        value += (each - value) * FINE_S / (lag_s + FINE_S)
        found[index] = value
    return np.interp(times, fine, found)


def logged(folder, times, sent, measured):
    """Write a log as `deploy` does; return the configuration."""
    count = sent.shape[1]
    frame = DataFrame(dict.fromkeys(NAMES, np.zeros(len(times))) | {"time_s": times + 100.0})
    frame[[f"sent{k}" for k in range(count)]], frame[[f"q{k}" for k in range(count)]] = sent, measured
    frame.to_parquet(folder / "setpoints.parquet", index=False)
    return compose("identify", [f"run={folder}"])


@pytest.mark.parametrize(("lag_s", "latency_s"), [(0.03, 0.0), (0.08, 0.04), (0.15, 0.12)])
def test_known_lag_and_latency_are_found(tmp_path, lag_s, latency_s, capsys):
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.uniform(0.8, 1.2, 12_000)) * PERIOD_S
    joints = range(3)
    sent = np.stack([motion(times, k) for k in joints], axis=1)
    measured = np.stack([lagging(times, k, lag_s, latency_s) for k in joints], axis=1)
    measured += rng.normal(0.0, 5e-4, measured.shape)
    measured[:, 2], sent[:, 2] = 0.0, 0.0  # stands still: nothing can be said of it
    found = json.loads(identify(logged(tmp_path, times, sent, measured)).read_text())
    assert [each["joint"] for each in found["joints"]] == [0, 1]
    for each in found["joints"]:
        assert each["lag_s"] == pytest.approx(lag_s, abs=3e-3)
        assert each["latency_s"] == pytest.approx(latency_s, abs=3e-3)
        assert each["lag_ci95"][0] < each["lag_s"] < each["lag_ci95"][1]
        assert each["error_rad"] == pytest.approx(4e-4, rel=0.2)  # resampling smooths the noise
    told = capsys.readouterr().out
    assert all(line in told for line in found["overrides"])
    compose("train", found["overrides"])


def test_the_simulated_arm_has_the_lag_of_its_servos(tmp_path):
    config = compose("train", [])
    scene = build_scene(config.robot, config.cell, config.engine.substeps)
    arm, times = SimulatedArm(scene.model, scene.home), np.arange(0.0, 12.0, PERIOD_S)
    sent = scene.home + 0.3 * np.stack([motion(times, k) - motion(0.0, k) for k in range(6)], axis=1)
    measured = np.empty_like(sent)
    for index, each in enumerate(sent):
        arm.send(each)
        measured[index] = arm.read().angles
    found = json.loads(identify(logged(tmp_path, times, sent, measured)).read_text())["joints"]
    assert len(found) == 6
    for each in found:
        assert each["lag_s"] + each["latency_s"] == pytest.approx(SERVO_LAG_S, abs=5e-3)


class Ticks:
    """A clock that each reading advances by a period of the set-points."""

    def __init__(self):
        self._count = count()

    def monotonic(self):
        return next(self._count) * PERIOD_S


class LaggingArm(LateArm):
    """An arm behind a network, whose servos follow low-pass filtered set-points."""

    def __init__(self, lag_s, *args):
        super().__init__(*args)
        self._gain, self._target = PERIOD_S / (lag_s + PERIOD_S), args[1].copy()

    def send(self, angles):
        self._target = self._target + self._gain * (angles - self._target)
        super().send(self._target)


@pytest.mark.parametrize("lag_s", [0.0, 0.05])
def test_a_deployment_tells_the_sum_of_lag_and_latency_of_its_arm(tmp_path, lag_s):
    asked = campaign(1, f"safety.lag_s={SERVO_LAG_S + lag_s}")
    scene = build_scene(asked.robot, asked.cell, 10)
    with patch("hrl_comfort.deploy.streamer.time", Ticks()):
        arm = partial(LaggingArm, lag_s, scene.model, scene.home, 0)
        run = Run(asked, Lockstep(arm, Limits.of(asked, scene), tmp_path / "setpoints.bin"), lambda: False, endure=True)
        run.all()
    run.write(tmp_path)
    found = json.loads(identify(compose("identify", [f"run={tmp_path}"])).read_text())["joints"]
    assert len(found) >= 3
    for each in found:  # each alone is not: a servo of second order looks like less lag and more latency
        assert each["lag_s"] + each["latency_s"] == pytest.approx(SERVO_LAG_S + lag_s + 2 * LATENCY_S, abs=5e-3)


def test_a_log_without_motion_is_refused(tmp_path):
    times = np.arange(0.0, 2.0, PERIOD_S)
    still = np.zeros((len(times), 6))
    with pytest.raises(ConfigError, match="no joint moves"):
        identify(logged(tmp_path, times, still, still))


def test_a_folder_without_a_log_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"holds no setpoints\.parquet"):
        identify(compose("identify", [f"run={tmp_path}"]))
