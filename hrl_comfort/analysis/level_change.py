"""The effect of a level that jumps in mid-task: the same episodes with the jump and without, over time.

An episode counts at a time only while it runs in both evaluations, so that both means are over the same
ones; the difference between them then has the interval of paired episodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from pandas import DataFrame

from hrl_comfort.analysis.intervals import Clusters
from hrl_comfort.config import CONTROL_STEP_S, ConfigError
from hrl_comfort.files.run_folder import Run
from hrl_comfort.files.tables import Floats, read_table

AFTER_S = 1.0
"""Time from the jump at which its effect is read."""
LATEST_STEPS = 6
"""Control steps from the jump to the first one under the new level, at most: a decision, and one more."""
SAME_M = 1e-3
"""Two evaluations whose tools are farther apart before the jump are not the same episodes."""
MEASURES = ("human_distance_m", "tool_speed_m_s")
EPISODE = ["train_seed", "episode"]
TOOL = ["tcp_x", "tcp_y", "tcp_z"]


@dataclass(frozen=True)
class Jump:
    """n episodes that run at the jump in both evaluations, at T times."""

    seconds: Floats
    """(T,) s from the jump."""
    values: dict[str, tuple[Floats, Floats]]
    """MEASURES to (n, T) without the jump and with it; NaN where one of the two does not run."""
    entries: DataFrame
    """(n) training seed and spawn of each, `success` without the jump and `success_jump`."""
    apart_before_m: float
    """Largest distance of the two evaluations' tools before the jump: 0 where they are the same policy."""

    @property
    def clusters(self) -> Clusters:
        """Training seed and spawn point of each episode."""
        return Clusters.of(self.entries)


def aligned(without: Sequence[Run], jumping: Sequence[Run], jump_s: float) -> Jump:
    """Return the episodes of both evaluations (a run a training seed), seconds counted from the jump.

    Raises:
      ConfigError: paths.csv is missing, holds an episode twice, no episode lasts until the jump, or the two
        differ in more than a level that changes at the jump.
    """
    at = round(jump_s / CONTROL_STEP_S)
    both = _recorded(without).merge(_recorded(jumping), on=[*EPISODE, "step"], suffixes=("", "_jump"))
    both = both.merge(both.loc[both["step"] == at, EPISODE], on=EPISODE)
    if both.empty:
        raise ConfigError(f"jump_s={jump_s}: no episode of both evaluations lasts so long")
    both["entry"] = both.groupby(EPISODE, dropna=False).ngroup()
    _check_levels(both, at)
    before = both[both["step"] <= at]
    apart = float(_length(before[TOOL].to_numpy() - before[[f"{name}_jump" for name in TOOL]].to_numpy()).max())
    if apart > SAME_M:
        raise ConfigError(
            f"jump_s={jump_s}: the two evaluations' tools are {apart:.3f} m apart before it; "
            "they must be the same policy and episodes"
        )

    def over_time(name: str) -> Floats:
        return both.pivot(index="entry", columns="step", values=name).to_numpy(float)

    seconds = (np.sort(both["step"].unique()) - at) * CONTROL_STEP_S
    values = {name: (over_time(name), over_time(f"{name}_jump")) for name in MEASURES}
    return Jump(seconds, values, both.drop_duplicates("entry").sort_values("entry"), apart)


def _recorded(runs: Sequence[Run]) -> DataFrame:
    """Return the rows of paths.csv of several runs, with the tool's speed and columns of their episodes."""
    tables = []
    for run in runs:
        path = None if run.paths is None else read_table(run.paths)
        if path is None or run.episodes is None:
            raise ConfigError(f"{run.folder} has no paths.csv; evaluate with record=true")
        about = run.episodes.reindex(columns=[*EPISODE, "spawn_id", "success"])
        tables.append(path.merge(about, on="episode").sort_values(["episode", "step"]))
    frame = pd.concat(tables, ignore_index=True)
    if frame.duplicated([*EPISODE, "step"]).any():
        raise ConfigError(f"{runs[0].folder}: an episode of a training seed is there twice")
    moved = frame.groupby(EPISODE, dropna=False)[TOOL].diff().to_numpy()
    return frame.assign(tool_speed_m_s=_length(moved) / CONTROL_STEP_S)


def _length(vectors: Floats) -> Floats:
    return np.asarray(np.linalg.norm(vectors, axis=1))


def _check_levels(both: DataFrame, at: int) -> None:
    """Raise ConfigError unless the level stays without the jump and leaves the same level with it, at step `at`.

    A level comes into force with the decision after it has changed, so a decision later will do.
    """
    for _, rows in both.groupby("entry"):
        first = rows["level"].iloc[0]
        if (rows["level"] != first).any() or rows["level_jump"].iloc[0] != first:
            raise ConfigError("the first of evaluations= must keep one level, that from which the second jumps")
        changed = rows.loc[rows["level_jump"] != first, "step"].min()
        if np.isnan(changed) and rows["step"].max() <= at + LATEST_STEPS:
            continue  # the episode ends too early to tell
        if not at <= changed <= at + LATEST_STEPS:
            when = "does not change by then" if np.isnan(changed) else f"changes at {changed * CONTROL_STEP_S:g} s"
            raise ConfigError(f"jump_s={at * CONTROL_STEP_S:g}: the level of the second evaluation {when}")


def numbers(data: Jump) -> dict[str, Any]:
    """Return the means AFTER_S after the jump, and the difference with its interval."""
    at = int(np.argmin(np.abs(data.seconds - AFTER_S)))
    reached = data.seconds[at] > AFTER_S - CONTROL_STEP_S / 2
    found: dict[str, Any] = {
        "jump_s": float(-data.seconds[0]),
        "after_s": AFTER_S,
        "episodes": 0,
        "episodes_at_jump": len(data.entries),
        "success": {"without": data.entries["success"].mean(), "with": data.entries["success_jump"].mean()},
        "tools_apart_before_m": data.apart_before_m,
    }
    for name, (without, jumping) in data.values.items():
        pair = np.stack([without[:, at], jumping[:, at]])
        pair = pair[:, np.isfinite(pair).all(axis=0)]
        if reached and pair.size:
            means = dict(zip(("without", "with"), pair.mean(axis=1).tolist(), strict=True))
            estimate = data.clusters.estimate(jumping[:, at] - without[:, at])
            assert estimate is not None, "some episode has a value"
            found["episodes"] = pair.shape[1]
            found[name] = {**means, "difference": estimate["mean"], "ci95": estimate["ci95"]}
    return found
