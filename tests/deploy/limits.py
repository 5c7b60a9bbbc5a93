"""Set-points beyond the rating in simulated time: `python -m tests.deploy.limits runs/robot_limits.csv 1e6`.

Runs of four episodes under every policy in turn until there are so many set-points; a line of the table is a policy.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from contextlib import suppress
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np
import torch
from pandas import DataFrame

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import VALIDATION_SEED, DeployConfig
from hrl_comfort.deploy.arms import PERIOD_S, SimulatedArm
from hrl_comfort.deploy.links import Lockstep
from hrl_comfort.deploy.runner import Run
from hrl_comfort.deploy.stops import StoppedError
from hrl_comfort.deploy.streamer import COLUMNS, ROUNDING, Limits
from hrl_comfort.safety.drive import rating_of
from hrl_comfort.scene.workcell import build_scene
from tests.deploy.faulty_link import BEHIND

REFERENCE = [f"policies.{name}=runs/reference/{name}" for name in ("pick", "place", "return")]
SHIELDED = [f"policies.{name}=runs/reference/shielded/seed2/{name}" for name in ("pick", "place", "return")]
POLICIES = {
    "reference cycle": ["task=cycle", "meta_controller=nearest", *REFERENCE],
    "shielded cycle": ["task=cycle", "meta_controller=nearest", *SHIELDED, *BEHIND],
    "random": ["task=pick", "policy=random"],
    "potential_field": ["task=pick", "policy=potential_field"],
    "expert": ["task=pick", "policy=expert"],
}
RUN_EPISODES = 4


def counted(overrides: list[str], seed: int) -> Counter[str]:
    """Return the number of set-points of a run, and of those beyond each limit."""
    fixed = ["human=random_walk", "confirm=yes", "output=none", f"episodes={RUN_EPISODES}", f"episode_seed={seed}"]
    asked = compose("deploy", [*overrides, *fixed])
    assert isinstance(asked, DeployConfig)
    scene, rating = build_scene(asked.robot, asked.cell, 10), rating_of(asked.robot)
    limits = Limits.of(asked, scene)
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log.bin"
        link = Lockstep(partial(SimulatedArm, scene.model, scene.home), limits, log)
        with suppress(StoppedError):
            Run(asked, link, lambda: False, endure=True).all()
        joints = len(scene.home)
        rows = np.fromfile(log).reshape(-1, len(COLUMNS) + 2 * joints)
    sent = np.vstack([scene.home[None].repeat(2, axis=0), rows[:, len(COLUMNS) : -joints]])
    speed = np.diff(sent, axis=0) / PERIOD_S
    acceleration = np.diff(speed, axis=0) / PERIOD_S
    fastest = limits.arm.speeds(limits.arm.pose(sent[1:]), speed).max(axis=0)
    beyond = {
        "beyond_joint_speed": (np.abs(speed) > rating.speed_rad_s * (1 + ROUNDING)).any(axis=1),
        "beyond_acceleration": (np.abs(acceleration) > rating.acceleration_rad_s2 * (1 + ROUNDING)).any(axis=1),
        "beyond_range": ((sent < limits.low - ROUNDING) | (sent > limits.high + ROUNDING)).any(axis=1),
        "beyond_tool_speed": fastest > rating.tool_speed_m_s * (1 + ROUNDING),
    }
    return Counter(set_points=len(rows), **{name: int(found.sum()) for name, found in beyond.items()})


def main(table: Path, wanted: int) -> None:
    torch.set_num_threads(1)
    totals: dict[str, Counter[str]] = {name: Counter() for name in POLICIES}
    for part in count():
        for name, overrides in POLICIES.items():
            totals[name].update(counted(overrides, VALIDATION_SEED + RUN_EPISODES * part))
            DataFrame([{"policy": name, **found} for name, found in totals.items() if found]).to_csv(table, index=False)
        if sum(found["set_points"] for found in totals.values()) >= wanted:
            return


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(float(sys.argv[2])))
