"""`hrl-comfort bench env`: the batched environment beside bare physics and the dm_control front."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median

import mujoco
import numpy as np
import torch
from mujoco import rollout
from pandas import DataFrame

from hrl_comfort.analysis.tables import markdown
from hrl_comfort.config import EnvConfig, TrainConfig
from hrl_comfort.config.compose import environment
from hrl_comfort.envs.dm import make_environment
from hrl_comfort.files.tables import read_table, write_table
from hrl_comfort.scene.workcell import CONTROL_SPEC
from hrl_comfort.sim.engine import Engine

ROWS = (1, 16, 64, 256)
REPEATS = 5
DECISIONS = 1024
"""Decisions a measurement, over all rows."""
OURS, BARE = "engine", "bare mujoco.rollout"
COLUMNS = ["rows", "loop", "round", "policy_steps_per_s"]


def bench_env(config: TrainConfig) -> Path:
    """Print decisions a second of the engine, of bare `mujoco.rollout` of the same work, and their ratio.

    Both run the same model, substeps and threads; measurements are interleaved. The dm_control front is
    measured at one row. What is measured goes to env.csv, which is returned.
    """
    torch.set_num_threads(1)
    env = environment(config)
    rates: list[list[object]] = []
    for rows in ROWS:
        loops = {OURS: engine_loop(env, rows), BARE: bare_loop(env, rows)}
        if rows == 1:
            loops["dm_control front"] = dm_loop(env)
        for turn in range(REPEATS):
            rates += [[rows, name, turn, rate(step, rows)] for name, step in loops.items()]
    path = Path(config.output) / "env.csv"
    write_table(path, COLUMNS, rates)
    print(table(read_table(path)), end="")
    return path


def table(rates: DataFrame) -> str:
    """Return the rows of env.csv as a Markdown table: medians, ranges and ratios."""
    return medians(rates, COLUMNS, BARE, lambda mine, bare: mine / bare, "of bare rollout")


def medians(
    rates: DataFrame, columns: Sequence[str], peer: str, ratio: Callable[[float, float], float], head: str
) -> str:
    """Return measurements as a Markdown table, with each one's ratio to `peer` in the same rounds.

    Columns are those of the CSV: the size, who was measured, the round, the rate.
    """
    size, name, _, rate_of = columns
    groups = rates.groupby([size, name], sort=False)[rate_of]
    lines = []
    for (count, who), each in groups:
        ratios = [ratio(one, other) for one, other in zip(each, groups.get_group((count, peer)), strict=True)]
        lines.append([str(count), who, ranged(each), "" if who == peer else ranged(ratios, 2)])
    return markdown([size, name, rate_of.replace("_per_", "/"), head], lines)


def rate(step: Callable[[], None], rows: int) -> float:
    """Return decisions a second of a loop whose call makes `rows` of them."""
    count = max(4, DECISIONS // rows)
    begin = time.perf_counter()
    for _ in range(count):
        step()
    return count * rows / (time.perf_counter() - begin)


def ranged(values: Sequence[float], digits: int = 0) -> str:
    """Return the median and the range."""
    return f"{median(values):,.{digits}f} ({min(values):,.{digits}f} to {max(values):,.{digits}f})"


def engine_loop(env: EnvConfig, rows: int) -> Callable[[], None]:
    """Return a call that makes one decision in each row and resets those that ended."""
    engine, rng = Engine(env, rows, 0), np.random.default_rng(0)
    engine.reset()

    def step() -> None:
        outcome = engine.step(rng.uniform(-1, 1, (rows, 6)))
        engine.reset(np.flatnonzero(outcome.done.numpy()))

    return step


def bare_loop(env: EnvConfig, rows: int) -> Callable[[], None]:
    """Return a call that rolls the same model through as many substeps, with controls made beforehand."""
    engine, rng = Engine(env, rows, 0), np.random.default_rng(0)
    engine.reset()
    control = engine.episodes.apply_action(rng.uniform(-1, 1, (rows, 6)))
    data = [mujoco.MjData(engine.scene.model) for _ in range(env.engine.threads)]
    physics = engine.physics

    def step() -> None:
        rollout.rollout(engine.scene.model, data, physics, control, control_spec=CONTROL_SPEC)

    return step


def dm_loop(env: EnvConfig) -> Callable[[], None]:
    """Return a call that makes one decision through the dm_control front."""
    environment, rng = make_environment(env, 0), np.random.default_rng(0)
    environment.reset()

    def step() -> None:
        if environment.step(rng.uniform(-1, 1, 6)).last():
            environment.reset()

    return step
