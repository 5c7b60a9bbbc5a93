"""`hrl-comfort bench env`: the batched environment beside bare physics and the dm_control front."""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median

import mujoco
import numpy as np
import torch
from mujoco import rollout
from rich.console import Console
from rich.table import Table

from hrl_comfort.compose import environment
from hrl_comfort.config import EnvConfig, TrainConfig
from hrl_comfort.envs.dm import make_environment
from hrl_comfort.scene.workcell import CONTROL_SPEC
from hrl_comfort.sim.engine import Engine

ROWS = (1, 16, 64, 256)
REPEATS = 5
DECISIONS = 1024
"""Decisions a measurement, over all rows."""


def bench_env(config: TrainConfig) -> None:
    """Print decisions a second of the engine, of bare `mujoco.rollout` of the same work, and their ratio.

    Both run the same model, substeps and threads; measurements are interleaved, the median of `REPEATS` is
    given with the range. The dm_control front is measured at one row.
    """
    torch.set_num_threads(1)
    env = environment(config)
    table = Table(
        title=f"{config.task.name}, {config.engine.threads} thread(s), decisions/s: median (least to most)"
    )
    for name in ("rows", "engine", "bare mujoco.rollout", "engine / bare", "dm_control front"):
        table.add_column(name, justify="right")
    for rows in ROWS:
        ours, bare = engine_loop(env, rows), bare_loop(env, rows)
        front = dm_loop(env) if rows == 1 else None
        rates: dict[str, list[float]] = {"ours": [], "bare": [], "dm": []}
        for _ in range(REPEATS):
            rates["ours"].append(rate(ours, rows))
            rates["bare"].append(rate(bare, rows))
            if front is not None:
                rates["dm"].append(rate(front, 1))
        ratio = median(a / b for a, b in zip(rates["ours"], rates["bare"], strict=True))
        dm = spread(rates["dm"]) if front is not None else ""
        table.add_row(str(rows), spread(rates["ours"]), spread(rates["bare"]), f"{ratio:.2f}", dm)
    Console().print(table)


def rate(step: Callable[[], None], rows: int) -> float:
    """Return decisions a second of a loop whose call makes `rows` of them."""
    count = max(4, DECISIONS // rows)
    begin = time.perf_counter()
    for _ in range(count):
        step()
    return count * rows / (time.perf_counter() - begin)


def spread(values: list[float]) -> str:
    """Return the median and the range."""
    return f"{median(values):,.0f} ({min(values):,.0f} to {max(values):,.0f})"


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
    control = engine.episodes.plan(rng.uniform(-1, 1, (rows, 6)))
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
