"""`hrl-comfort bench start`: how long a command takes until it does what it was asked for."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from hrl_comfort.compose import override
from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.experiments.bench import ranged
from hrl_comfort.experiments.measure import write_table
from hrl_comfort.experiments.own_process import COMMAND, same_paths
from hrl_comfort.experiments.panels import markdown
from hrl_comfort.experiments.statistics import Row, number, read_rows

REPEATS = 5
LOOK_S = 0.01
"""Between two looks at whether the training has made its first step."""
HELP, STEP = "hrl-comfort --help", "hrl-comfort train, to its first step"
COLUMNS = ["command", "round", "seconds"]


def bench_start(config: TrainConfig, overrides: Sequence[str]) -> Path:
    """Print seconds from the command to the end of `--help` and to a training's first step.

    Every measurement is a process of its own; they are interleaved. `overrides` are those of `config` and go
    to the training. What is measured goes to start.csv, which is returned.
    """
    starts: dict[str, Callable[[], float]] = {HELP: help_s, STEP: lambda: step_s(config, overrides)}
    times: list[list[object]] = []
    for turn in range(REPEATS):
        times += [[name, turn, round(measure(), 3)] for name, measure in starts.items()]
    path = Path(config.output) / "start.csv"
    write_table(path, COLUMNS, times)
    print(table(read_rows(path)), end="")
    return path


def table(rows: Sequence[Row]) -> str:
    """Return the rows of start.csv as a Markdown table: medians and ranges."""
    found: dict[str, list[float]] = {}
    for row in rows:
        found.setdefault(row["command"], []).append(number(row["seconds"]))
    return markdown(["command", "seconds"], [[name, ranged(each, 2)] for name, each in found.items()])


def help_s() -> float:
    """Return the seconds that `--help` takes."""
    began = time.perf_counter()
    subprocess.run([*COMMAND, "--help"], check=True, stdout=subprocess.DEVNULL, env=same_paths())
    return time.perf_counter() - began


def step_s(config: TrainConfig, overrides: Sequence[str]) -> float:
    """Return the seconds from the command to the first row of metrics.csv.

    That is one decision in every row of the engine, and the updates that fall due with it.

    Raises:
      ConfigError: it ended without one.
    """
    with TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        log = run / "metrics.csv"
        short = [f"agent.decisions={config.engine.rows}", "agent.warmup_decisions=0", "agent.log_every=1"]
        words = ["train", *overrides, *short, override("output", run)]
        began = time.perf_counter()
        training = subprocess.Popen(
            [*COMMAND, *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=same_paths()
        )
        while training.poll() is None and not has_row(log):
            time.sleep(LOOK_S)
        seconds = time.perf_counter() - began
        _, said = training.communicate()
        if not has_row(log):
            raise ConfigError(f"the training made no step: {said.decode(errors='replace').strip()}")
    return seconds


def has_row(log: Path) -> bool:
    """Return whether a line is below the header of a metrics.csv."""
    return log.exists() and log.read_bytes().count(b"\n") > 1
