"""Scripted grasps of every arm, gripper and object: `python -m tests.hand.campaign TABLE 50`.

A line of the table is an object that lies at a random place within 7 cm of where it arrives, up to 50 in each
combination. A campaign that was stopped goes on after its last line.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from pandas import DataFrame, read_csv

from hrl_comfort.composition.compose import compose_environment
from hrl_comfort.config import EnvConfig
from hrl_comfort.policies.load import make_policy
from hrl_comfort.scene.grippers import GRIPPERS
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.step_result import StepResult

ROBOTS = ("ur3e", "ur5e", "ur10e")
JITTER_M = {"grasp": 0.07, "bench_hand": 0.02}
"""Cell -> how far objects lie from where they arrive, so that they stay on the table."""
AT_ONCE = 10
"""Places of a combination that are tried before those of the next."""
KEY = ["robot", "gripper", "cell", "object", "place"]


def decisions(config: EnvConfig, rows: int, seed: int = 0) -> Iterator[tuple[NDArray[np.bool_], StepResult]]:
    """Run the expert until the first episode of every one of `rows` cells has ended.

    Yield in which rows (N,) it goes on and the result of each decision.
    """
    engine = Engine(config, rows, seed)
    state, act = engine.reset(), make_policy("expert", engine.episodes.subtask, engine.scene, config, 0)
    going = np.ones(rows, dtype=bool)
    while going.any():
        result = engine.step(act(state).numpy())
        yield going, result
        done = result.done.numpy()
        going = going & ~done
        state = engine.reset(np.flatnonzero(done))
    engine.close()


def grasps(robot: str, gripper: str, cell: str, kind: str, batch: int) -> list[dict[str, Any]]:
    """Return the lines of AT_ONCE places of a combination."""
    asked = [f"cell={cell}", f"robot={robot}", f"gripper={gripper}", f"task.object={kind}", "human=none"]
    config = compose_environment("train", [*asked, "task=pick_place", f"task.object_jitter_m={JITTER_M[cell]}"])
    aloft, fastest = np.zeros(AT_ONCE, dtype=bool), np.zeros(AT_ONCE)
    lines: dict[int, dict[str, Any]] = {}
    for going, result in decisions(config, AT_ONCE, batch):
        state, instants = result.state, result.instants
        valid = result.valid.numpy() & going[:, None]
        aloft |= ((instants.aloft_steps[..., 0] > 0).numpy() & valid).any(axis=1)
        speed = torch.linalg.vector_norm(instants.objects_vel[..., 0, :], dim=-1).numpy()
        carried = instants.carried[..., 0].numpy() & valid
        fastest = np.maximum(fastest, np.where(carried, speed, 0.0).max(axis=1))
        for row in np.flatnonzero(going & result.done.numpy()):
            picked, drops = bool(state.stage[row] > 0), int(state.drops[row])
            lines[row] = {
                "robot": robot, "gripper": gripper, "cell": cell, "object": kind, "place": AT_ONCE * batch + row,
                "lifted": bool(aloft[row]), "held": picked and not drops, "placed": bool(result.success[row]),
                "drops": drops, "slip_mm": 1000 * float(state.slip[row]), "fastest_m_s": fastest[row],
                "steps": int(state.steps[row]),
            }  # fmt: skip
    return [lines[row] for row in sorted(lines)]


def combinations() -> list[tuple[str, str, str, str]]:
    """Return every arm, gripper, cell and object of it."""
    kinds = [(cell, kind) for cell in JITTER_M for kind in compose_environment("train", [f"cell={cell}"]).cell.objects]
    return [(robot, gripper, *each) for robot, gripper, each in product(ROBOTS, GRIPPERS, kinds)]


def campaign(table: Path, places: int) -> None:
    """Grasp at `places` of each combination, some of each in turn, and write what came out."""
    torch.set_num_threads(1)
    lines: list[dict[str, Any]] = read_csv(table).to_dict("records") if table.exists() else []  # type: ignore[assignment]
    known = {tuple(line[name] for name in KEY) for line in lines}
    for batch, each in product(range(places // AT_ONCE), combinations()):
        if (*each, AT_ONCE * batch) in known:
            continue
        found = grasps(*each, batch)
        lines += found
        table.parent.mkdir(parents=True, exist_ok=True)
        DataFrame(lines).round(4).to_csv(table, index=False)
        print(*each, [sum(line[name] for line in found) for name in ("lifted", "held", "placed")], flush=True)


if __name__ == "__main__":
    campaign(Path(sys.argv[1]), int(sys.argv[2]))
