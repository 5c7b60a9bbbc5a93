"""Cycles of a fake UR with a Robotiq hand, and grips lost by force: `python -m tests.deploy.hand_campaign TABLE 50`.

They run in simulated time: the expert, which grasps, is too slow for real time. Arm and hand have 20 ms latency in each
direction, and the arm's network loses 1 % of its packages. A line of the table is a cycle, then a grip; a campaign that
was stopped goes on after its last line.
"""

from __future__ import annotations

import os
import socket
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
from pandas import DataFrame, read_csv

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import VALIDATION_SEED, DeployConfig
from hrl_comfort.deploy.arms import PERIOD_S, Arm, Equipped
from hrl_comfort.deploy.hands.robotiq import RobotiqHand
from hrl_comfort.deploy.links import Lockstep
from hrl_comfort.deploy.runner import Run
from hrl_comfort.deploy.stops import StoppedError
from hrl_comfort.deploy.streamer import COLUMNS, HAND_COLUMNS, Limits
from hrl_comfort.scene.workcell import scene_of
from tests.deploy.campaign import LATENCY_S, LOSS
from tests.deploy.fake_robotiq import RobotiqWorld
from tests.deploy.late import Late, LateLoopback, PulledHand

HAND = ["cell=grasp", "gripper=robotiq_2f85", "policy=expert", "human=none", "confirm=yes", "output=none"]
NOTICED_S = 0.3
"""Longest time until a lost grip is noticed."""
WEAK_N = 20.0
"""Force of the grip of an object that is pulled out, the least of a 2F-85, so that the arm holds against the pull."""
FIRST, LAST = 50, 600
"""Set-points for which an object is held before it is pulled out."""


def cycle(index: int, pull_after: int = 0) -> dict[str, Any]:
    """Run a cycle, of which what is held is pulled out after some set-points; 0: never. Return what came out."""
    words = [
        f"safety.latency_s={2 * LATENCY_S}",
        f"episode_seed={VALIDATION_SEED + index}",
        "task.object_jitter_m=0.05",
    ]
    words += [f"robot.gripper.force_n={WEAK_N}"] if pull_after else []
    asked = compose("deploy", [*HAND, "task=cycle", *words])
    assert isinstance(asked, DeployConfig)
    scene = scene_of(asked)
    hand, why = PulledHand(scene, pull_after, index), ""
    world = RobotiqWorld(hand)

    def connect(*args: Any) -> LateLoopback:
        return LateLoopback(world.server, hand, round(LATENCY_S / PERIOD_S))

    def arm() -> Arm:
        late = Late(world, scene.home, LATENCY_S, LOSS, index)
        return Equipped(late, RobotiqHand("anywhere", asked.robot.gripper.force_n))

    log = Path(tempfile.mkdtemp()) / "log.bin"
    clock = SimpleNamespace(monotonic=lambda: hand.ticks * PERIOD_S)
    with patch.object(socket, "create_connection", connect), patch("hrl_comfort.deploy.hands.robotiq.time", clock):
        run = Run(asked, Lockstep(arm, Limits.of(asked, scene), log), lambda: False)
        try:
            run.all()
        except StoppedError as stopped:
            why = str(stopped)
    rows = np.fromfile(log).reshape(-1, len(COLUMNS) + 2 * len(scene.home) + len(HAND_COLUMNS))
    braked = np.flatnonzero(rows[:, COLUMNS.index("planned")] == -2)
    found: dict[str, Any] = {"cycle": index, "pulled": pull_after > 0, "stopped": why}
    found["success"] = bool(run.result.episodes and run.result.episodes[-1].success)
    if pull_after:
        stopped = int(braked[0]) + 1 if len(braked) else sys.maxsize
        late_s = (stopped - hand.lost_at) * PERIOD_S if 0 < hand.lost_at < stopped else 0.0
        told = "grip lost" in why and 0 < hand.pulled_at < stopped
        found |= {"noticed": told and late_s <= NOTICED_S, "noticed_s": round(late_s, 3)}
    return found


def campaign(table: Path, count: int) -> None:
    """Run cycles, and as many grips that are lost; write what came out, and go on after what was written."""
    torch.set_num_threads(1)
    lines: list[dict[str, Any]] = []
    if table.exists():
        lines = read_csv(table).fillna({"stopped": ""}).to_dict("records")  # type: ignore[assignment]
    for index in range(len(lines), 2 * count):
        pull_after = int(np.random.default_rng(index).integers(FIRST, LAST)) if index >= count else 0
        lines.append(cycle(index % count, pull_after))
        table.parent.mkdir(parents=True, exist_ok=True)
        DataFrame(lines).to_csv(table, index=False)
        whole, lost = ([each for each in lines if each["pulled"] == pulled] for pulled in (False, True))
        done, told = sum(each["success"] for each in whole), sum(each["noticed"] for each in lost)
        said = f"{done} of {len(whole)} cycles, {told} of {len(lost)} lost grips noticed"
        print(f"{said}; {lines[-1]}", flush=True)


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    campaign(Path(sys.argv[1]), int(sys.argv[2]))
