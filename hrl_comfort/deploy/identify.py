"""`hrl-comfort identify`: lag and latency of an arm's servos from the set-points and angles that `deploy` logged."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import scipy  # its parts are loaded when they are needed
from numpy.typing import NDArray
from rich.console import Console

from hrl_comfort.analysis.tables import in_terminal
from hrl_comfort.config import ConfigError, IdentifyConfig
from hrl_comfort.deploy.arms import PERIOD_S
from hrl_comfort.files.atomic import write_json
from hrl_comfort.files.output import output_file
from hrl_comfort.files.tables import column, read_table
from hrl_comfort.scene.servos import SERVO_LAG_S

Array = NDArray[np.float64]
LOG = "setpoints.csv"
"""Stem of the log; `deploy` writes it as parquet."""
PARTS = 8
"""Parts of equal length of the log, whose fits give the interval."""
FEWEST = 3
"""Parts in which a joint has to move."""
MOVES_RAD = np.radians(2.0)
"""Range of a joint's set-points above which it moves in a part."""
LONGEST_S = 1.0
"""Largest lag and latency that are looked for."""
FIRST = ((0.03, 0.01), (0.1, 0.1), (0.05, 0.3))
"""Lags and latencies, s, from which the fit begins."""


@dataclass(frozen=True)
class Estimate:
    """Lag and latency of one joint, s, each with its 95 % interval, and the error that remains, rad (rms)."""

    joint: int
    lag_s: float
    lag_ci95: tuple[float, float]
    latency_s: float
    latency_ci95: tuple[float, float]
    error_rad: float


def identify(config: IdentifyConfig) -> Path:
    """Fit the servo model to the log of `run`; print lags, latencies and overrides; return the JSON file of the table.

    Raises:
      ConfigError: there is no log, it is damaged, or no joint moves in it.
    """
    output = Path(config.output or Path(config.run) / "identify.json")
    log = read_table(Path(config.run) / LOG)
    if log is None:
        raise ConfigError(f"run={config.run!r} holds no setpoints.parquet; hrl-comfort deploy writes one")
    joints = sum(name.startswith("sent") for name in log)
    time = column(log, "time_s")
    sent, measured = (np.stack([column(log, f"{name}{k}") for k in range(joints)]) for name in ("sent", "q"))
    found = [each for k in range(joints) if (each := estimate(k, time, sent[k], measured[k])) is not None]
    if not found:
        raise ConfigError(f"run={config.run!r}: no joint moves by {np.degrees(MOVES_RAD):.0f}° in {FEWEST} of {PARTS} "
                          "parts of the log; run longer episodes")  # fmt: skip
    overrides = overrides_of(found)
    with output_file(output):
        write_json(output, {"joints": [asdict(each) for each in found], "overrides": overrides})
    Console().print(_table(found))
    print(f"the model with it: {' '.join(overrides)}\n{output}")
    return output


def estimate(joint: int, time: Array, sent: Array, measured: Array) -> Estimate | None:
    """Return the servo model of a joint, from set-points and angles (n,) rad at times (n,) s; None if it hardly moves.

    The model is a delay and a first-order lag. The interval is Student's t over the fits of PARTS parts of the log.
    """
    even = np.arange(time[0], time[-1], PERIOD_S)
    parts = []
    for times in np.array_split(even, PARTS):
        asked = np.interp(times, time, sent)
        if len(times) > 1 and np.ptp(asked) > MOVES_RAD:
            parts.append(fit(times, time, sent, np.interp(times, time, measured)))
    if len(parts) < FEWEST:
        return None
    lag, latency, error = np.array(parts).T
    return Estimate(joint, *_mean(lag), *_mean(latency), float(np.sqrt(np.square(error).mean())))


def _mean(values: Array) -> tuple[float, tuple[float, float]]:
    """Return the mean of values (n,) and its 95 % interval."""
    mean = float(values.mean())
    half = float(scipy.stats.t.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values)))
    return mean, (mean - half, mean + half)


def fit(times: Array, time: Array, sent: Array, measured: Array) -> tuple[float, float, float]:
    """Return lag, s, latency, s, and error, rad (rms), of the least squares fit to angles `measured` (m,) rad.

    They are measured at `times` (m,) s; the set-points are `sent` (n,) rad at `time` (n,) s. The first LONGEST_S of
    `times` settle the filter.
    """
    settled = times >= min(times[0] + LONGEST_S, times[len(times) // 2])

    def residual(lag_latency: Array) -> Array:
        return (modelled(times, time, sent, *lag_latency) - measured)[settled]

    fits = [scipy.optimize.least_squares(residual, first, bounds=(0.0, LONGEST_S), diff_step=1e-3) for first in FIRST]
    best = min(fits, key=lambda each: each.cost)
    return float(best.x[0]), float(best.x[1]), float(np.sqrt(np.square(best.fun).mean()))


def modelled(times: Array, time: Array, sent: Array, lag_s: float, latency_s: float) -> Array:
    """Return the angles (m,) rad at evenly spaced `times` (m,) of a joint with the set-points `sent` at `time` (n,) s.

    The lag is that of `sim.variation.randomisation.Servos`: behind a ramp.
    """
    late = np.interp(times - latency_s, time, sent)
    step = times[1] - times[0]
    gain = step / (lag_s + step)
    found, _ = scipy.signal.lfilter([gain], [1, gain - 1], late, zi=[(1 - gain) * late[0]])
    return np.asarray(found)


def overrides_of(found: list[Estimate]) -> list[str]:
    """Return the overrides that set the model, and what the shield allows for, to these joints."""
    lags, latencies = [each.lag_s for each in found], [each.latency_s for each in found]
    more = [max(0.0, lag - SERVO_LAG_S) for lag in lags]
    return [
        f"randomise.servo_lag_s=[{min(more):.3f},{max(more):.3f}]",
        f"randomise.latency_s=[{min(latencies):.3f},{max(latencies):.3f}]",
        f"safety.lag_s={SERVO_LAG_S + max(more):.3f}",
        f"safety.latency_s={max(latencies):.3f}",
    ]


def _table(found: list[Estimate]) -> object:
    def cell(value: float, interval: tuple[float, float]) -> str:
        return f"{1e3 * value:.1f} [{1e3 * interval[0]:.1f}, {1e3 * interval[1]:.1f}]"

    lines = [
        [str(e.joint), cell(e.lag_s, e.lag_ci95), cell(e.latency_s, e.latency_ci95), f"{np.degrees(e.error_rad):.3f}"]
        for e in found
    ]
    return in_terminal(["joint"], ["lag (ms)", "latency (ms)", "error (°)"], lines)
