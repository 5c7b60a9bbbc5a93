"""The effect of a level that jumps in mid-task: the same episodes with the jump and without, over time.

An episode counts at a time only while it runs in both evaluations, so that both means are over the same
ones; the difference between them then has the interval of paired episodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from pandas import DataFrame

from hrl_comfort.analysis.intervals import Clusters
from hrl_comfort.config import CONTROL_STEP_S, ConfigError
from hrl_comfort.files.run_folder import Run, recorded_paths, row_of
from hrl_comfort.files.tables import Floats, column
from hrl_comfort.plots.style import BLUE, VERMILLION, band, note, styled

AFTER_S = 1.0
"""When the effect of the jump is read, from the jump on."""
LATEST_STEPS = 6
"""Control steps from the jump to the first one under the new level, at most: a decision, and one more."""
SAME_M = 1e-3
"""Two evaluations whose tools are farther apart before the jump are not the same episodes."""
LEAST_SHARE = 0.25
"""Of the episodes that run at the jump; the figure ends where fewer still run."""
MEASURES = {"human_distance_m": "distance to person (m)", "tool_speed_m_s": "tool speed (m/s)"}


@dataclass(frozen=True)
class Jump:
    """n episodes that run at the jump in both evaluations, at T times."""

    seconds: Floats
    """(T,) s from the jump."""
    values: dict[str, Floats]
    """MEASURES to (2, n, T), without the jump and with it; NaN where one of the two does not run."""
    success: tuple[float, float]
    """Shares of the n episodes that succeed, without the jump and with it."""
    clusters: Clusters
    apart_before_m: float
    """Largest distance of the two evaluations' tools before the jump: 0 where they are the same policy."""


def aligned(without: Sequence[Run], jumping: Sequence[Run], jump_s: float) -> Jump:
    """Return the episodes of both evaluations (a run a training seed), seconds counted from the jump.

    Raises:
      ConfigError: paths.csv is missing, holds an episode twice, no episode lasts until the jump, or the two
        differ in more than a level that changes at the jump.
    """
    at = round(jump_s / CONTROL_STEP_S)
    recorded = [_recorded(runs) for runs in (without, jumping)]
    both = [key for key in recorded[0] if key in recorded[1]]
    pairs = {key: (recorded[0][key][1], recorded[1][key][1]) for key in both}
    pairs = {key: pair for key, pair in pairs.items() if _last(pair) >= at}
    if not pairs:
        raise ConfigError(f"jump_s={jump_s}: no episode of both evaluations lasts so long")
    length = 1 + max(_last(pair) for pair in pairs.values())
    values = {name: np.full((2, len(pairs), length), np.nan) for name in MEASURES}
    apart = 0.0
    for i, pair in enumerate(pairs.values()):
        _check_levels(pair, at)
        steps = 1 + _last(pair)
        tools = [path[["tcp_x", "tcp_y", "tcp_z"]].to_numpy()[:steps] for path in pair]
        apart = max(apart, float(np.linalg.norm(tools[0] - tools[1], axis=1)[: at + 1].max()))
        for k, (path, tool) in enumerate(zip(pair, tools, strict=True)):
            values["human_distance_m"][k, i, :steps] = path["human_distance_m"][:steps]
            speed = np.linalg.norm(np.diff(tool, axis=0), axis=1) / CONTROL_STEP_S
            values["tool_speed_m_s"][k, i, 1:steps] = speed
    if apart > SAME_M:
        raise ConfigError(
            f"jump_s={jump_s}: the two evaluations' tools are {apart:.3f} m apart before it; "
            "they must be the same policy and episodes"
        )
    seconds = np.asarray((np.arange(length) - at) * CONTROL_STEP_S, dtype=np.float64)
    rows, jumped = (DataFrame([each[key][0] for key in pairs]) for each in recorded)
    success = float(column(rows, "success").mean()), float(column(jumped, "success").mean())
    return Jump(seconds, values, success, Clusters.of(rows), apart)


def _check_levels(pair: Sequence[DataFrame], at: int) -> None:
    """Raise ConfigError unless the first path keeps its level and the second leaves it at control step `at`.

    A level comes into force with the decision after it has changed, so a decision later will do.
    """
    without, jumping = (column(path, "level") for path in pair)
    changed = np.flatnonzero(jumping != jumping[0])
    if (without != without[0]).any() or without[0] != jumping[0]:
        raise ConfigError("the first of evaluations= must keep one level, that from which the second jumps")
    if not len(changed) and len(jumping) > at + LATEST_STEPS + 1:
        raise ConfigError(f"jump_s={at * CONTROL_STEP_S:g}: the level of the second evaluation does not change by then")
    if len(changed) and not at <= changed[0] <= at + LATEST_STEPS:
        raise ConfigError(
            f"jump_s={at * CONTROL_STEP_S:g}: the level of the second evaluation changes at "
            f"{changed[0] * CONTROL_STEP_S:g} s"
        )


def _recorded(runs: Sequence[Run]) -> dict[tuple[str, int], tuple[dict[str, Any], DataFrame]]:
    """Return rows of episodes.csv and recorded paths by training seed and episode."""
    found: dict[tuple[str, int], tuple[dict[str, Any], DataFrame]] = {}
    for run in runs:
        if run.paths is None:
            raise ConfigError(f"{run.folder} has no paths.csv; evaluate with record=true")
        for recorded, path in recorded_paths(run).items():
            row = row_of(run, recorded) or {}
            key = (str(row.get("train_seed", "")), recorded[0])
            if key in found:
                raise ConfigError(f"{run.folder}: episode {key[1]} of training seed {key[0]!r} is there twice")
            found[key] = row, path
    return found


def _last(pair: Sequence[DataFrame]) -> int:
    """Return the last control step that both paths have."""
    return min(len(path) for path in pair) - 1


def numbers(data: Jump) -> dict[str, Any]:
    """Return the means AFTER_S after the jump, and the difference with its interval."""
    at = int(np.argmin(np.abs(data.seconds - AFTER_S)))
    reached = data.seconds[at] > AFTER_S - CONTROL_STEP_S / 2
    found: dict[str, Any] = {
        "jump_s": float(-data.seconds[0]),
        "after_s": AFTER_S,
        "episodes": 0,
        "episodes_at_jump": data.values["human_distance_m"].shape[1],
        "success": dict(zip(("without", "with"), data.success, strict=True)),
        "tools_apart_before_m": data.apart_before_m,
    }
    for name, (without, jumping) in data.values.items():
        difference = jumping[:, at] - without[:, at]
        there = np.isfinite(difference)
        if not reached or not there.any():
            continue
        estimate = data.clusters.estimate(difference)
        assert estimate is not None, "some episode has a value"
        found["episodes"] = int(there.sum())
        found[name] = {
            "without": float(without[there, at].mean()),
            "with": float(jumping[there, at].mean()),
            "difference": estimate["mean"],
            "ci95": estimate["ci95"],
        }
    return found


def jump(data: Jump) -> Figure:
    """Draw distance and tool speed with the jump and without (above), and their difference (below)."""
    in_progress = np.isfinite(data.values["human_distance_m"]).all(axis=0).sum(axis=0)
    shown = in_progress >= max(1.0, LEAST_SHARE * in_progress[data.seconds >= 0].max())
    with styled():
        figure = Figure(figsize=(7.6, 4.4))
        axes = figure.subplots(2, 2, sharex=True, height_ratios=(1.5, 1))
        for (above, below), (name, words) in zip(axes.T, MEASURES.items(), strict=True):
            values = data.values[name][:, :, shown]
            seconds = data.seconds[shown]
            for label, colour, each in zip(
                ("without the jump", "with the jump"), (BLUE, VERMILLION), values, strict=True
            ):
                band(above, seconds, *data.clusters.bands(each), colour, label=label)
            band(below, seconds, *data.clusters.bands(values[1] - values[0]), "#444444")
            below.axhline(0, color="#999999", linewidth=0.7)
            for axis in (above, below):
                axis.axvline(0, color="#444444", linewidth=0.8, linestyle=":")
            above.set_ylabel(words)
            below.set(xlabel="time from the jump (s)", ylabel=f"with − without ({words.split('(')[1]}")
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
        note(
            figure,
            f"{in_progress[data.seconds >= 0].max()} episodes that run at the jump in both; to where "
            f"{100 * LEAST_SHARE:.0f} % still do; bands: 95 % intervals",
        )
        return figure
