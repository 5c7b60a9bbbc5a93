"""`hrl-comfort bench cores`: what a second training gains on a second core."""

from __future__ import annotations

import multiprocessing
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import torch

from hrl_comfort.config import TrainConfig
from hrl_comfort.experiments.bench import ranged
from hrl_comfort.experiments.measure import write_table
from hrl_comfort.experiments.panels import markdown
from hrl_comfort.experiments.statistics import Row, number, read_rows
from hrl_comfort.experiments.train import Training
from hrl_comfort.experiments.train_cell import steps_of

ROUNDS = 5
SECONDS = 6.0
"""Of each measurement."""
SIZE = 256
"""Of the square matrices that are multiplied."""
TRAINING, APART, PRODUCTS = "training", "training, cells apart", "matrix products"
COLUMNS = ["loop", "processes", "round", "rounds_per_s"]
Loop = Callable[[TrainConfig], float]


def bench_cores(config: TrainConfig) -> Path:
    """Print how much more two processes do than one, of training and of bare products; write cores.csv.

    Each process has one thread, and where cells are apart (`agent.cells_apart`) a second one beside it.
    Measurements are interleaved; the ratios say how much of what the cores offer two trainings take, and what
    it brings to have the cells apart.
    """
    found: list[list[object]] = []
    loops: dict[str, Loop] = {TRAINING: training, APART: training, PRODUCTS: multiplying}
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        list(pool.map(multiplying, [config] * 2))  # both processes have started and imported
        for turn in range(ROUNDS):
            for name, loop in loops.items():
                for count in (1, 2):
                    agent = replace(config.agent, cells_apart=name == APART)
                    seeds = [replace(config, agent=agent, train_seed=k, episode_seed=k) for k in range(count)]
                    found.append([name, count, turn, sum(pool.map(loop, seeds))])
    path = Path(config.output) / "cores.csv"
    write_table(path, COLUMNS, found)
    print(table(read_rows(path)), end="")
    return path


def table(rows: Sequence[Row]) -> str:
    """Return the rows of cores.csv as a Markdown table: decisions or products a second, ratios by round."""
    rates = {(row["loop"], row["processes"], row["round"]): number(row["rounds_per_s"]) for row in rows}
    turns = sorted({row["round"] for row in rows})

    def rate(name: str, count: str) -> list[float]:
        return [rates[name, count, turn] for turn in turns]

    def over(above: list[float], below: list[float]) -> list[float]:
        return [one / other for one, other in zip(above, below, strict=True)]

    loops = (TRAINING, APART, PRODUCTS)
    gains = {name: over(rate(name, "2"), rate(name, "1")) for name in loops}
    lines = [[name, *(ranged(rate(name, count)) for count in "12"), ranged(gains[name], 2)] for name in loops]
    apart = [ranged(over(rate(APART, count), rate(TRAINING, count)), 2) for count in "12"]
    lines.append([f"{APART} / {TRAINING}", *apart, ""])
    lines.append([f"{TRAINING} / {PRODUCTS}", "", "", ranged(over(gains[TRAINING], gains[PRODUCTS]), 2)])
    return markdown(["loop", "one, per s", "two at once, per s", "two / one"], lines)


def training(config: TrainConfig) -> float:
    """Return decisions a second of a training, updates and all."""
    torch.set_num_threads(1)
    agent = replace(config.agent, warmup_decisions=0, guide=None, guided_rows=0, successor=None)
    alone = replace(config, agent=agent)
    with tempfile.TemporaryDirectory() as folder, closing(steps_of(alone)) as steps:
        trained = Training(alone, steps, Path(folder))
        while len(trained.learner.buffer) < agent.batch_size:
            trained.decide()
            trained.take_in()
        before, began = trained.decisions, time.perf_counter()
        while time.perf_counter() - began < SECONDS:
            trained.decide()
            trained.learn(trained.due())
            trained.take_in()
        return (trained.decisions - before) / (time.perf_counter() - began)


def multiplying(config: TrainConfig) -> float:
    """Return products of two matrices a second."""
    torch.set_num_threads(1)
    left, right = torch.rand(2, SIZE, SIZE)
    count, began = 0, time.perf_counter()
    while time.perf_counter() - began < SECONDS:
        torch.mm(left, right)
        count += 1
    return count / (time.perf_counter() - began)
