"""Cycles on a fake UR: `python -m tests.deploy.campaign runs/robot_cycles.csv 100`.

The arm's network has 20 ms latency in each direction, up to 2 ms jitter, and loses 1 % of its packages. The policies
were trained behind the shield; beside them walk people who keep to the acceleration that the shield assumes. A run
lasts ten cycles or until the arm is stopped; the next one goes on with the cycle after. A line of the table is a run.

`python -m tests.deploy.campaign TABLE 100 simulated` runs them in simulated time, with the same delays and losses.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from pandas import DataFrame

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import VALIDATION_SEED, DeployConfig
from hrl_comfort.deploy.arms import PERIOD_S, SimulatedArm
from hrl_comfort.deploy.links import STREAMER, Link, Lockstep, Paced, prefer
from hrl_comfort.deploy.runner import Run, rehearse
from hrl_comfort.deploy.stops import StoppedError
from hrl_comfort.deploy.streamer import COLUMNS, TICKS, Limits
from hrl_comfort.deploy.ur import UrArm
from hrl_comfort.safety.drive import rating_of
from hrl_comfort.scene.workcell import Scene, build_scene
from tests.deploy.fake_ur import Faults, fake_ur
from tests.deploy.faulty_link import BEHIND
from tests.deploy.late import Late

Array = NDArray[np.float64]
HOST = f"127.9.{os.getpid() % 250}.1"
LATENCY_S, JITTER_S, LOSS = 0.02, 0.002, 0.01
CHAIN = [f"policies.{name}=runs/reference/shielded/seed2/{name}" for name in ("pick", "place", "return")]
PEOPLE = ["human=mixture", "~human.mixture.random_walk", "~human.mixture.approach"]
"""Without the motions that have no bound on acceleration: beside them the shield has to stop."""
RUN_CYCLES = 10
EMPTY_PERIODS = 2500


def config(episodes: int, *more: str) -> DeployConfig:
    fixed = ["task=cycle", "meta_controller=nearest", *PEOPLE, "confirm=yes", "output=none"]
    late = f"safety.latency_s={2 * LATENCY_S}"
    found = compose("deploy", [*CHAIN, *BEHIND, *fixed, late, f"episodes={episodes}", *more])
    assert isinstance(found, DeployConfig)
    return found


class LateArm(Late):
    """An arm in simulated time at the other end of the network."""

    def __init__(self, model: mujoco.MjModel, start: Array, seed: int) -> None:
        super().__init__(SimulatedArm(model, start), start, LATENCY_S, LOSS, seed)


@contextmanager
def link_to(scene: Scene, asked: DeployConfig, log: Path, seed: int, simulated: bool) -> Iterator[Link]:
    limits = Limits.of(asked, scene)
    if simulated:
        yield Lockstep(partial(LateArm, scene.model, scene.home, seed), limits, log)
        return
    with fake_ur(HOST, scene.model, scene.home, Faults(LATENCY_S, JITTER_S, LOSS, seed=seed)):
        yield Paced(partial(UrArm, HOST, 5.0), limits, log)


def cycles(table: Path, count: int, simulated: bool) -> None:
    """Run cycles on the fake robot, or in simulated time; write what was measured after each run."""
    torch.set_num_threads(1)
    scene, first, lines = build_scene(config(1).robot, config(1).cell, 10), 0, []
    if not simulated:  # as `deploy` does, so that the code is warm
        with link_to(scene, config(1), Path(os.devnull), 0, simulated=True) as link:
            rehearse(config(1), link, lambda: False)
    while first < count:
        asked = config(min(RUN_CYCLES, count - first), f"episode_seed={VALIDATION_SEED + first}")
        log, why = Path(tempfile.mkdtemp()) / "log.bin", ""
        load = os.getloadavg()[0]
        with link_to(scene, asked, log, first, simulated) as link:
            run = Run(asked, link, lambda: False)
            try:
                run.all()
            except StoppedError as stopped:
                why = str(stopped)
        began = len(run.result.episodes)
        if why and not (began and run.result.episodes[-1].truncated):  # on its way to the start: failed too
            began += 1
        done = sum(each.success for each in run.result.episodes)
        line: dict[str, float | str] = {"first_cycle": first, "cycles": began, "succeeded": done, "stopped": why}
        if not simulated:
            line |= {"load": load, **measured(log, scene, asked), "empty_loop_error_p99_ms": empty_loop()}
        lines.append(line)
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
    cycles(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:] == ["simulated"])
