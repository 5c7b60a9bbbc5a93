"""`hrl-comfort bench safety`: what rating and shield cost the engine, in processor time."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from pathlib import Path

from pandas import DataFrame

from hrl_comfort.benchmarks.env import engine_loop
from hrl_comfort.benchmarks.measure import Rate, interleaved, rate, ratios, spread
from hrl_comfort.config import EnvConfig, TrainConfig
from hrl_comfort.files.run_config import environment

NUM_ENVS = (1, 16, 64)
COLUMNS = ("num_envs", "loop", "round", "policy_steps_per_s")
PAPER, RATED = "paper's arm", "rated arm"
WORLDS = {
    PAPER: ("paper", "none", "worst"),
    RATED: ("collaborative", "none", "worst"),
    "shield, observed": ("collaborative", "ssm", "observed"),
    "shield, worst": ("collaborative", "ssm", "worst"),
}
"""Loop -> `robot.rating`, `safety.kind`, `safety.bound`."""


def bench_safety(config: TrainConfig) -> Path:
    """Print policy steps a second of processor time of the engine with and without rating and shield.

    Actions are random. Write the measurements to safety.csv and return it.
    """
    env = environment(config)

    def loops(cells: int) -> dict[str, Rate]:
        return {
            name: partial(rate, engine_loop(_world(env, *world), cells), cells, clock=time.process_time)
            for name, world in WORLDS.items()
        }

    path = Path(config.output) / "safety.csv"
    found = interleaved(path, COLUMNS, NUM_ENVS, loops)
    print(table(found), end="")
    print(cost(found[found["num_envs"] == 1], env.task.action_repeat))
    return path


def table(frame: DataFrame) -> str:
    """Return the rows of safety.csv as a Markdown table: medians, ranges and ratios."""
    return ratios(frame, RATED, "of the rated arm")


def cost(one_row: DataFrame, action_repeat: int) -> str:
    """Return a line with what rating and shield take of a control step of one row, ms."""
    ms = 1000 / one_row.pivot(index="round", columns="loop", values="policy_steps_per_s") / action_repeat
    more = [
        f"{name} {spread(ms[name] - ms[before], 2)}"
        for name, before in zip(WORLDS, (None, PAPER, RATED, RATED), strict=True)
        if before
    ]
    return f"ms of a control step of one row that are added: {', '.join(more)}"


def _world(env: EnvConfig, rating: str, kind: str, bound: str) -> EnvConfig:
    safety = replace(env.safety, kind=kind, bound=bound)
    return replace(env, robot=replace(env.robot, rating=rating), safety=safety)
