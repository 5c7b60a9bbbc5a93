"""`hrl-comfort bench env`: the batched environment beside bare physics and the dm_control front."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from mujoco import rollout
from numpy.typing import NDArray
from pandas import DataFrame

from hrl_comfort.benchmarks.measure import Rate, interleaved, rate, ratios
from hrl_comfort.composition.compose import compose_environment
from hrl_comfort.config import EnvConfig, TrainConfig
from hrl_comfort.envs.dm import make_environment
from hrl_comfort.files.run_config import environment
from hrl_comfort.scene.workcell import CONTROL_SPEC
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.physics import Rollout
from hrl_comfort.sim.processes.engine import make_engine

Array = NDArray[np.float64]
NUM_ENVS = (1, 16, 64, 256, 1024)
_SHIELDED = (
    "human=mixture", "safety=ssm", "robot.rating=collaborative", "task.terminate_on=unsafe_contact",
)  # fmt: skip
WORLDS = {
    "shielded": ("task=cycle", *_SHIELDED, "task.observation=sight"),
    "shift": ("task=shift", *_SHIELDED, "comfort=distance_and_speed", "task.observation=sight"),
    "grasp": ("task=cycle", "cell=grasp", *_SHIELDED, "task.observation=sight"),
}
"""World beside the one that is configured -> what configures it."""
SIZES = {"grasp": (64,)}
"""World -> its numbers of cells in the place of NUM_ENVS."""
COLUMNS = ("world", "num_envs", "loop", "round", "policy_steps_per_s")
BARE, OWN_STATES = "bare mujoco.rollout", "mujoco.rollout of the engine's states"
DECISIONS = 16
"""Number of the engine's decisions that are rolled out again."""
WARM_UP = 32
"""Number of decisions before them."""


def bench_env(config: TrainConfig) -> Path:
    """Print policy steps a second of the engine, of bare `mujoco.rollout` of the same work, and their ratio.

    All run the same model, substeps and threads, in the configured world, called by its task, and in WORLDS. Bare
    physics repeats a decision of arms at home; beside it decisions that the engine made are rolled out again, whose
    physics takes longer. With `engine.processes` the engine is measured in that many too. The dm_control front is
    measured with one cell. Write the measurements to env.csv and return it.
    """
    torch.set_num_threads(1)
    here = environment(config)
    worlds = {here.task.name: here}
    for name, words in WORLDS.items():
        worlds[name] = replace(compose_environment("train", words), engine=here.engine)

    def loops(size: tuple[str, int]) -> dict[str, Rate]:
        (world, cells), env = size, worlds[size[0]]
        alone = env.in_one_process()
        found = {
            "engine": engine_loop(alone, cells),
            BARE: bare_loop(alone, cells),
            OWN_STATES: replay_loop(alone, cells),
        }
        if (processes := min(env.engine.processes, cells)) > 1:
            found[f"engine, {processes} processes"] = engine_loop(env, cells)
        if cells == 1 and world == here.task.name:
            found["dm_control front"] = dm_loop(env)
        return {name: partial(rate, step, cells) for name, step in found.items()}

    path = Path(config.output) / "env.csv"
    sizes = [(world, cells) for world in worlds for cells in SIZES.get(world, NUM_ENVS)]
    print(table(interleaved(path, COLUMNS, sizes, loops)), end="")
    return path


def table(frame: DataFrame) -> str:
    """Return the rows of env.csv as a Markdown table: medians, ranges and ratios."""
    return ratios(frame, BARE, "of bare rollout")


def engine_loop(env: EnvConfig, cells: int) -> Callable[[], None]:
    """Return a call that makes one policy step in each cell and resets those that ended."""
    engine, rng = make_engine(env, cells, 0), np.random.default_rng(0)
    shape = cells, engine.episodes.action_dim
    engine.reset()

    def step() -> None:
        outcome = engine.step(rng.uniform(-1, 1, shape))
        engine.reset(np.flatnonzero(outcome.done.numpy()))

    return step


def bare_loop(env: EnvConfig, cells: int) -> Callable[[], object]:
    """Return a call that rolls the same model through as many substeps, with precomputed controls."""
    engine, rng = Engine(env, cells, 0), np.random.default_rng(0)
    engine.reset()
    engine.physics.begin_decision()
    action = rng.uniform(-1, 1, (cells, engine.episodes.action_dim))
    parts = engine.episodes.controls(action, lambda: engine.physics.joints)
    control = np.concatenate(list(parts), axis=1)
    model = engine.scene.model
    data = [mujoco.MjData(model) for _ in range(env.engine.threads)]
    return partial(rollout.rollout, model, data, engine.physics.state, control, control_spec=CONTROL_SPEC)


class Recorded(Rollout):
    """Physics that keeps the states (N, nstate) and controls (N, T, ncontrol) of its decisions."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.kept: list[tuple[Array, list[Array]]] = []

    def begin_decision(self) -> None:
        """See `Physics`."""
        super().begin_decision()
        self.kept.append((self.state.copy(), []))

    def run(self, control: Array, rows: NDArray[np.int64] | None) -> Array:
        """See `Physics`."""
        self.kept[-1][1].append(control)
        return super().run(control, rows)


def replay_loop(env: EnvConfig, cells: int) -> Callable[[], None]:
    """Return a call that rolls out the next of some decisions that the engine made, with their states and controls."""
    engine, rng = Engine(env, cells, 0, physics=Recorded), np.random.default_rng(0)
    physics, shape = engine.physics, (cells, engine.episodes.action_dim)
    assert isinstance(physics, Recorded)
    engine.reset()
    for _ in range(WARM_UP + DECISIONS):
        outcome = engine.step(rng.uniform(-1, 1, shape))
        engine.reset(np.flatnonzero(outcome.done.numpy()))
        del physics.kept[:-DECISIONS]
    model = engine.scene.model
    data = [mujoco.MjData(model) for _ in range(env.engine.threads)]
    decisions = cycle([(state, np.concatenate(controls, axis=1)) for state, controls in physics.kept])

    def step() -> None:
        rollout.rollout(model, data, *next(decisions), control_spec=CONTROL_SPEC)

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
