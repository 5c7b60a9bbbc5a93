"""Cycles on a fake UR: `python -m tests.deploy.campaign docs/tables/robot_cycles.csv 100`.

The arm's network has 20 ms latency in each direction, up to 2 ms jitter, and loses 1 % of its packages. A run lasts ten
cycles or until the arm is stopped; the next one goes on with the cycle after. A line of the table is a run.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
import torch
from pandas import DataFrame

from hrl_comfort.config import VALIDATION_SEED, DeployConfig
from hrl_comfort.config.compose import compose
from hrl_comfort.deploy.arms import PERIOD_S, SimulatedArm
from hrl_comfort.deploy.links import STREAMER, Paced, prefer
from hrl_comfort.deploy.runner import Run
from hrl_comfort.deploy.stops import StoppedError
from hrl_comfort.deploy.streamer import COLUMNS, TICKS, Limits
from hrl_comfort.deploy.ur import UrArm
from hrl_comfort.safety.drive import rating_of
from hrl_comfort.safety.geometry import ArmGeometry
from hrl_comfort.scene.workcell import Scene, build_scene
from tests.deploy.fake_ur import Faults, fake_ur

HOST = f"127.9.{os.getpid() % 250}.1"
LATENCY_S, JITTER_S, LOSS = 0.02, 0.002, 0.01
CHAIN = [f"policies.{name}=runs/reference/{name}" for name in ("pick", "place", "return")]
RUN_CYCLES = 10
EMPTY_PERIODS = 2500


def config(episodes: int, *more: str) -> DeployConfig:
    fixed = ["task=cycle", "meta_controller=scripted", "human=still", "confirm=yes", "output=none"]
    found = compose("deploy", [*CHAIN, *fixed, f"episodes={episodes}", *more])
    assert isinstance(found, DeployConfig)
    return found


def limits_of(asked: DeployConfig, scene: Scene) -> Limits:
    return Limits(rating_of(asked.robot), ArmGeometry(scene), *scene.joint_range.T)


def cycles(table: Path, count: int) -> None:
    """Run cycles on the fake robot; write what was measured after each run."""
    torch.set_num_threads(1)
    scene, first, lines = build_scene(config(1).robot, config(1).cell, 10), 0, []
    while first < count:
        asked = config(min(RUN_CYCLES, count - first), f"episode_seed={VALIDATION_SEED + first}")
        log, why = Path(tempfile.mkdtemp()) / "log.bin", ""
        load = os.getloadavg()[0]
        with fake_ur(HOST, scene.model, scene.home, Faults(LATENCY_S, JITTER_S, LOSS, seed=first)):
            run = Run(asked, Paced(partial(UrArm, HOST, 5.0), limits_of(asked, scene), log), lambda: False)
            try:
                run.all()
            except StoppedError as stopped:
                why = str(stopped)
        began = max(1, len(run.result.episodes))  # one that was stopped on its way to the start counts as failed
        done = sum(each.success for each in run.result.episodes)
        line = {"first_cycle": first, "cycles": began, "succeeded": done, "stopped": why, "load": load}
        lines.append(line | measured(log, scene, asked) | {"empty_loop_error_p99_ms": empty_loop()})
        DataFrame(lines).round(4).to_csv(table, index=False)
        first += began
        print(f"{sum(each['succeeded'] for each in lines)} of {first} cycles; {lines[-1]}", flush=True)


def measured(log: Path, scene: Scene, asked: DeployConfig) -> dict[str, float]:
    """Return timing, shares of the rating, and distances (degrees) from a simulation of the same set-points."""
    joints = len(scene.home)
    rows = np.fromfile(log).reshape(-1, len(COLUMNS) + 2 * joints)
    stamp, late, code = rows[:, 0], rows[:, 1], rows[:, 4]
    sent, reached = rows[:, len(COLUMNS) : -joints], rows[:, -joints:]
    speed = np.diff(sent, axis=0) / PERIOD_S
    rating = rating_of(asked.robot)
    acceleration = np.diff(speed, axis=0) / PERIOD_S / rating.acceleration_rad_s2
    arm, shift = SimulatedArm(scene.model, scene.home), round(2 * LATENCY_S / PERIOD_S)
    predicted = np.empty_like(sent)
    for k, each in enumerate(sent):
        arm.send(each)
        predicted[k] = arm.read().angles
    apart = np.degrees(np.abs(predicted[:-shift] - reached[shift:]).max(axis=1))
    error = 1e3 * np.abs(np.diff(stamp) - PERIOD_S)
    return {
        "set_points": len(rows),
        "late_control_steps": int((code == -1).sum() / TICKS),
        "speed_share": float(np.abs(speed / rating.speed_rad_s).max()),
        "acceleration_share": float(np.abs(acceleration).max()),
        "joints_apart_p99_deg": float(np.percentile(apart, 99)),
        "joints_apart_most_deg": float(apart.max()),
        "largest_delay_ms": float(1e3 * late.max()),
        "period_error_p99_ms": float(np.percentile(error, 99)),
    }


def empty_loop() -> float:
    """Return the 99th percentile (ms) of the period error of a loop that does nothing, at the streamer's priority."""
    prefer(STREAMER)
    due, stamps = time.monotonic(), []
    for _ in range(EMPTY_PERIODS):
        due += PERIOD_S
        time.sleep(max(0.0, due - time.monotonic()))
        stamps.append(time.monotonic())
    prefer(0)
    return float(np.percentile(1e3 * np.abs(np.diff(stamps) - PERIOD_S), 99))


if __name__ == "__main__":
    cycles(Path(sys.argv[1]), int(sys.argv[2]))
