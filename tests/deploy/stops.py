"""Every stop condition at random moments, in simulated time.

`python -m tests.deploy.stops runs/robot_stops.csv 50` writes the table.

A run of `pick` is stopped at a random moment, its tables are written, and the next run begins where the arm stands. A
line of the table is a kind of stop.
"""

from __future__ import annotations

import sys
import tempfile
import warnings
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from functools import partial
from io import StringIO
from multiprocessing import Pipe
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S, VALIDATION_SEED
from hrl_comfort.deploy.arms import PERIOD_S
from hrl_comfort.deploy.links import Server
from hrl_comfort.deploy.runner import LOG, Run
from hrl_comfort.deploy.stops import INTERRUPTED, STOPPED, StoppedError
from hrl_comfort.deploy.streamer import COLUMNS, TICKS, Streamer
from hrl_comfort.files.tables import read_table
from tests.deploy.faulty_arm import FaultyArm
from tests.deploy.faulty_link import AWAY, CLOCK, FaultyLink, cell, config, simulated_time

Array = NDArray[np.float64]
SAYS = {
    "limit": "limit: the next set-point has ",
    "shield at zero": "shield at zero: a person could reach the arm before it is slow",
    "stale person": "stale person: position 0.",
    "stale level": "stale level: no good value for 0.1 s",
    "late cycle": "late cycle: 2 control steps in a row had no set-point in time",
    "lost connection": "lost connection: no answer",
    "protective stop": "protective stop",
    "emergency stop": "emergency stop",
    "interrupted": "interrupted",
    "runner gone": "the runner has gone",
}
"""Beginning of the line that says why."""
FIRST, LAST = 6, 30
"""Control steps among which the moment is drawn, after the first decision."""


@dataclass
class Injection:
    """Result of one run that was stopped."""

    said: str = ""
    code: int = 0
    rest_s: float = 0.0
    """From the first set-point that brakes to rest."""
    over_s: float = 0.0
    """That, less the time in which the rating brings the set-points of that moment to rest."""
    acceleration_share: float = 0.0
    log_complete: bool = False
    restarted: bool = False

    def braked(self, rows: Array, start: Array) -> None:
        """Take in the log (n, W) of an arm that stood at `start` (J,) rad."""
        rating, joints = cell()[1].rating, len(start)
        sent = np.vstack([start, start, rows[:, len(COLUMNS) : -joints]])
        speed = np.diff(sent, axis=0) / PERIOD_S
        braking, moving = rows[:, COLUMNS.index("planned")] < 0, np.abs(speed[1:]).max(axis=1) > 0
        if not braking.any():
            return
        first, last = int(braking.argmax()), int(np.flatnonzero(moving)[-1])
        self.rest_s = (last + 1 - first) * PERIOD_S
        self.over_s = self.rest_s - float(rating.stopping_time(speed[first][None])[0])
        self.acceleration_share = float(np.abs(np.diff(speed, axis=0) / PERIOD_S / rating.acceleration_rad_s2).max())
        self.log_complete = bool(braking[-1] and not moving[-1] and len(rows) % TICKS == 0)


def stopped(kind: str, seed: int) -> Injection:
    """Stop a run at a random moment, and run the next one to its end."""
    start, at = cell()[0].home, int(np.random.default_rng(seed).integers(FIRST, LAST))
    with simulated_time(), tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # at first no level has come
        output, found = Path(folder), Injection()
        run = begun(FaultyLink(kind, at, start, output / "setpoints.bin"), kind, seed)
        try:
            run.all()
        except StoppedError as error:
            found.said, found.code = str(error), error.code
        rows = log_of(output / "setpoints.bin")
        found.braked(rows, start)
        with redirect_stdout(StringIO()):
            run.write(output)
        episodes, paths = read_table(output / "episodes.csv"), read_table(output / "paths.csv")
        found.log_complete &= len(pd.read_parquet(output / LOG)) == len(rows)
        found.log_complete &= episodes is not None and list(episodes["truncated"]) == [True]
        found.log_complete &= paths is not None and len(paths) > 0
        found.restarted = restarts(kind, rows[-1, -len(start) :], output / "again.bin", seed)
    return found


def restarts(kind: str, angles: Array, log: Path, seed: int) -> bool:
    """Return whether the next run begins at the joint angles (J,) rad and ends without a stop."""
    CLOCK.place = AWAY
    again = begun(FaultyLink(f"no {kind}", 10**6, angles, log), kind, seed)
    again.all()
    return [each.truncated for each in again.result.episodes] == [False]


def begun(link: FaultyLink, kind: str, seed: int) -> Run:
    """Return a run of its own episode on the link."""
    link.run = Run(replace(config(kind), episode_seed=seed), link, link.interrupted)
    if kind == "stale level":
        link.tell_level()
    return link.run


def left(seed: int) -> Injection:
    """Let the runner end at a random moment, while its streamer keeps the wall clock."""
    scene, limits = cell()
    rng, found = np.random.default_rng(seed), Injection(code=STOPPED)
    ours, theirs = Pipe()
    with simulated_time() as clock, tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.bin"
        with path.open("wb") as file:
            streamer = Streamer(FaultyArm(scene.model, scene.home, "none", 0), limits, file)
            ticks, end = iter(range(10**6)), int(rng.integers(FIRST, LAST) * TICKS + rng.integers(TICKS))
            way, report = rng.uniform(-0.3, 0.3, len(scene.home)), streamer.report()

            def plan() -> None:
                """Send what the runner sends: a plan each control step, until it is gone."""
                nonlocal report
                if (tick := next(ticks)) == end:
                    ours.close()
                elif tick < end and tick % TICKS == TICKS // 2:
                    while ours.poll():
                        report = ours.recv()
                    velocity = limits.rating.follow(report.velocity[None], way[None])[0]
                    ours.send((report.step + 1, report.point + velocity * CONTROL_STEP_S))

            clock.slept = plan
            Server(theirs, streamer).run()
        found.said, rows = streamer.stopped, log_of(path)
        found.braked(rows, scene.home)
        clock.slept = lambda: None
        found.restarted = restarts("runner gone", rows[-1, -len(scene.home) :], path, seed)
    return found


def log_of(path: Path) -> Array:
    """Return the log (n, W) of a streamer."""
    return np.fromfile(path).reshape(-1, len(COLUMNS) + 2 * len(cell()[0].home))


def kind_line(kind: str, count: int, first: int = VALIDATION_SEED) -> dict[str, float]:
    """Return a line of the table: the results of `count` runs."""
    once = left if kind == "runner gone" else partial(stopped, kind)
    found = [once(seed) for seed in range(first, first + count)]
    code = INTERRUPTED if kind == "interrupted" else STOPPED
    return {
        "injected": count,
        "said_in_one_line": sum(
            each.said.startswith(SAYS[kind]) and "\n" not in each.said and each.code == code for each in found
        ),
        "log_complete": sum(each.log_complete for each in found),
        "restarted": sum(each.restarted for each in found),
        "longest_brake_ms": 1e3 * max(each.rest_s for each in found),
        "most_over_rated_ms": 1e3 * max(each.over_s for each in found),
        "acceleration_share": max(each.acceleration_share for each in found),
    }


def main(table: Path, count: int) -> None:
    torch.set_num_threads(1)
    lines: list[dict[str, str | float]] = []
    for kind in SAYS:
        lines.append({"stop": kind, **kind_line(kind, count)})
        pd.DataFrame(lines).round(4).to_csv(table, index=False)
        print(lines[-1], flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
