"""Rows of episodes.csv. This module knows no torch: a wrong column is refused before torch is imported."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from hrl_comfort.comfort.trajectory import MEASURES


@dataclass(frozen=True)
class Episode:
    """One row of episodes.csv (docs/metrics.md); None is written as an empty cell."""

    task: str
    policy: str
    train_seed: int | None
    split: str
    episode_seed: int
    episode: int
    colour: str
    spawn_id: int | None
    motion_id: int
    seen: bool | None
    comfort_level: int | None
    human: str
    precision_m: float
    success: bool
    steps: int
    policy_steps: int
    # `return` is a Python keyword; the column is named without the underscore.
    return_: float
    contact: bool
    unsafe_contact: bool
    other_collision: str
    truncated: bool
    balls_placed: int
    comfort_level_mean: float | None
    shield_share_mean: float | None
    protective_stops: int | None
    measures: dict[str, float | None]
    """By the names of `comfort.trajectory.MEASURES`; each is a column of its own."""
    max_episode_steps: int
    """Time limit, control steps, that was in force when the episode ended; not a column."""

    def row(self) -> dict[str, Any]:
        """Return the cells by column."""
        return {**{name.rstrip("_"): getattr(self, name) for name in OWN}, **self.measures}


OWN = tuple(field.name for field in fields(Episode) if field.name not in ("measures", "max_episode_steps"))
"""Fields of an Episode that are a column each."""
COLUMNS = (*(name.rstrip("_") for name in OWN), *MEASURES)
"""Of episodes.csv."""
