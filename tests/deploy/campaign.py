"""Cycles on a fake UR, and stops of every kind: `python -c "from tests.deploy.campaign import cycles; cycles(100)"`.

Prints what docs/robot.md tells. The arm's network has 20 ms latency in each direction and loses 1 % of its packages.
"""

from __future__ import annotations

import os
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
import torch

from hrl_comfort.config import VALIDATION_SEED, DeployConfig
from hrl_comfort.config.compose import compose
from hrl_comfort.deploy.arms import PERIOD_S, SimulatedArm
from hrl_comfort.deploy.links import Paced, prefer
from hrl_comfort.deploy.runner import Run
from hrl_comfort.deploy.stops import StoppedError
from hrl_comfort.deploy.streamer import COLUMNS, Limits
from hrl_comfort.deploy.ur import UrArm
from hrl_comfort.safety.drive import rating_of
from hrl_comfort.safety.geometry import ArmGeometry
from hrl_comfort.scene.workcell import Scene, build_scene
from tests.deploy.fake_ur import Faults, fake_ur

HOST = f"127.9.{os.getpid() % 250}.1"
LATENCY_S, LOSS = 0.02, 0.01
CHAIN = [f"policies.{name}=runs/reference/{name}" for name in ("pick", "place", "return")]


def config(episodes: int, *more: str) -> DeployConfig:
    fixed = ["task=cycle", "meta_controller=scripted", "human=still", "confirm=yes", "output=none"]
    found = compose("deploy", [*CHAIN, *fixed, f"episodes={episodes}", *more])
    assert isinstance(found, DeployConfig)
    return found


def limits_of(asked: DeployConfig, scene: Scene) -> Limits:
    return Limits(rating_of(asked.robot), ArmGeometry(scene), *scene.joint_range.T)


def cycles(count: int) -> None:
    """Run cycles on the fake robot, ten a run; print success, timing, and how far joints are from a simulation."""
    torch.set_num_threads(1)
    scene = build_scene(config(1).robot, config(1).cell, 10)
    done: list[bool] = []
    for first in range(0, count, 10):
        asked = config(min(10, count - first), f"episode_seed={VALIDATION_SEED + first}")
        log = Path(tempfile.mkdtemp()) / "log.bin"
        with fake_ur(HOST, scene.model, scene.home, Faults(LATENCY_S, 0.002, LOSS)):
            run = Run(asked, Paced(partial(UrArm, HOST, 5.0), limits_of(asked, scene), log), lambda: False)
            try:
                run.all()
            except StoppedError as stopped:
                print(f"stopped: {stopped}")
        done += [each.success for each in run.result.episodes]
        print(f"cycles: {sum(done)} of {len(done)} succeed")
        tell(log, scene, asked)
    empty()


def tell(log: Path, scene: Scene, asked: DeployConfig) -> None:
    joints = len(scene.home)
    rows = np.fromfile(log).reshape(-1, len(COLUMNS) + 2 * joints)
    stamp, late, code = rows[:, 0], rows[:, 1], rows[:, 4]
    sent, measured = rows[:, len(COLUMNS) : -joints], rows[:, -joints:]
    speed = np.diff(sent, axis=0) / PERIOD_S
    rating = rating_of(asked.robot)
    acceleration = np.diff(speed, axis=0) / PERIOD_S / rating.acceleration_rad_s2
    print(f"set-points: {len(rows)}; late control steps: {int((code == -1).sum() / 10)}")
    print(f"largest share of speed {np.abs(speed / rating.speed_rad_s).max():.4f}, of acceleration", end=" ")
    print(f"{np.abs(acceleration).max():.7f}")
    told("period error", np.abs(np.diff(stamp) - PERIOD_S))
    told("delay", late)
    arm = SimulatedArm(scene.model, scene.home)
    shift = round(2 * LATENCY_S / PERIOD_S)
    predicted = np.empty_like(sent)
    for k, each in enumerate(sent):
        arm.send(each)
        predicted[k] = arm.read().angles
    apart = np.abs(np.degrees(predicted[:-shift] - measured[shift:]))
    print(f"joints from the prediction: p99 {np.percentile(apart.max(axis=1), 99):.3f}°, largest {apart.max():.3f}°")


def empty() -> None:
    """Print the timing of a loop that does nothing, at the streamer's priority."""
    prefer(50)
    due = time.monotonic()
    stamps = []
    for _ in range(15000):
        due += PERIOD_S
        time.sleep(max(0.0, due - time.monotonic()))
        stamps.append(time.monotonic())
    prefer(0)
    told("empty loop's period error", np.abs(np.diff(stamps) - PERIOD_S))


def told(name: str, seconds: np.ndarray) -> None:
    p50, p99, most = (1e3 * np.percentile(seconds, p) for p in (50, 99, 100))
    print(f"{name}: median {p50:.3f}, p99 {p99:.3f}, largest {most:.3f} ms")
