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
    episode_seed: int | None
    episode: int
    object: str
    spawn_id: int | None
    motion_id: int
    person_id: int | None
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
    objects_placed: int
    comfort_level_mean: float | None
    shield_share_mean: float | None
    protective_stops: int | None
    human_beyond_bound: int | None
    drops: int | None
    slip_mm: float | None
    object_lost: bool | None
    diverged: bool | None
    measures: dict[str, float | None]
    """By the names of RATES and of `comfort.trajectory.MEASURES`; each is a column of its own."""
    max_episode_steps: int
    """Time limit, control steps, that was in force when the episode ended; not a column."""

    def row(self) -> dict[str, Any]:
        """Return the cells by column."""
        own = {name.rstrip("_"): getattr(self, name) for name in OWN}
        return {name: own.get(name, self.measures.get(name)) for name in COLUMNS}


OWN = tuple(field.name for field in fields(Episode) if field.name not in ("measures", "max_episode_steps"))
"""Fields of an Episode that are a column each."""
RATES = (
    "discomfort_per_min", "avoidable_discomfort_per_min", "idle_discomfort_per_min", "excess_closeness_mean_m",
    "person_level_mean", "person_rating_mean", "regret_per_min", "objects_lost", "objects_per_min", "contacts_per_h",
    "unsafe_contacts_per_h", "other_collisions_per_h", "protective_stops_per_min", "orders_missed_per_min",
)  # fmt: skip
"""Measures of `evaluation.rates`; those after the first seven are of a shift alone, the last of orders."""
COLUMNS = (*(name.rstrip("_") for name in OWN), *RATES, *MEASURES)
"""Of episodes.csv."""
