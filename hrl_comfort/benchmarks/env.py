"""`hrl-comfort bench env`: the batched environment beside bare physics and the dm_control front."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import torch
from mujoco import rollout
from pandas import DataFrame

from hrl_comfort.benchmarks.measure import Rate, interleaved, ratios
from hrl_comfort.config import EnvConfig, TrainConfig
from hrl_comfort.config.compose import environment
from hrl_comfort.envs.dm import make_environment
from hrl_comfort.scene.workcell import CONTROL_SPEC
from hrl_comfort.sim.engine import Engine

NUM_ENVS = (1, 16, 64, 256)
ROUNDS = 5
POLICY_STEPS = 1024
"""Policy steps of a measurement, over all cells."""
OURS, BARE = "engine", "bare mujoco.rollout"
COLUMNS = ("num_envs", "loop", "round", "policy_steps_per_s")


def bench_env(config: TrainConfig) -> Path:
    """Print policy steps a second of the engine, of bare `mujoco.rollout` of the same work, and their ratio.

    Both run the same model, substeps and threads. The dm_control front is measured with one cell. Write the
    measurements to env.csv and return it.
    """
    torch.set_num_threads(1)
    env = environment(config)

    def loops(cells: int) -> dict[str, Rate]:
        found = {OURS: timed(engine_loop(env, cells), cells), BARE: timed(bare_loop(env, cells), cells)}
        return found | ({"dm_control front": timed(dm_loop(env), 1)} if cells == 1 else {})

    path = Path(config.output) / "env.csv"
    print(table(interleaved(path, COLUMNS, NUM_ENVS, loops, ROUNDS)), end="")
    return path


def table(frame: DataFrame) -> str:
    """Return the rows of env.csv as a Markdown table: medians, ranges and ratios."""
    return ratios(frame, BARE, "of bare rollout")


def timed(step: Callable[[], None], cells: int) -> Rate:
    """Return the measurement of a loop whose call makes `cells` policy steps."""

    def rate() -> float:
        count = max(4, POLICY_STEPS // cells)
        step()  # warm up
        began = time.perf_counter()
        for _ in range(count):
            step()
        return count * cells / (time.perf_counter() - began)

    return rate


def engine_loop(env: EnvConfig, cells: int) -> Callable[[], None]:
    """Return a call that makes one policy step in each cell and resets those that ended."""
    engine, rng = Engine(env, cells, 0), np.random.default_rng(0)
    shape = engine.reset().joint_target.shape

    def step() -> None:
        outcome = engine.step(rng.uniform(-1, 1, shape))
        engine.reset(np.flatnonzero(outcome.done.numpy()))

    return step


def bare_loop(env: EnvConfig, cells: int) -> Callable[[], None]:
    """Return a call that rolls the same model through as many substeps, with precomputed controls."""
    engine, rng = Engine(env, cells, 0), np.random.default_rng(0)
    control = engine.episodes.apply_action(rng.uniform(-1, 1, engine.reset().joint_target.shape))
    data = [mujoco.MjData(engine.scene.model) for _ in range(env.engine.threads)]
    physics = engine.physics

    def step() -> None:
        rollout.rollout(engine.scene.model, data, physics, control, control_spec=CONTROL_SPEC)

    return step


def dm_loop(env: EnvConfig) -> Callable[[], None]:
    """Return a call that makes one policy step through the dm_control front."""
    environment, rng = make_environment(env, 0), np.random.default_rng(0)
    shape = environment.action_spec().shape
    environment.reset()

    def step() -> None:
        if environment.step(rng.uniform(-1, 1, shape)).last():
            environment.reset()

    return step
