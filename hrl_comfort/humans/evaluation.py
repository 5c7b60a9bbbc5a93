"""Evaluation splits: the committed set of 1,000 spawns, motion seeds and episode seeds, and validation draws."""

from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.resources import files
from typing import Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hrl_comfort.config import FIRST_SEED, SPLITS

COLUMNS = ("episode", "episode_seed", "spawn_id", "x", "y", "motion_id", "seen")
MOTION_STREAM = 7
"""Second word of the random key of a motion; it keeps motions and episodes on separate streams."""


@dataclass(frozen=True)
class EvaluationSet:
    """Columns of a split, each (E,); position (E, 2) m, cell frame.

    `spawn_id` is -1 where the spawn is drawn as in training; `position` and `seen` are then void.
    """

    episode: NDArray[np.int64]
    episode_seed: NDArray[np.int64]
    spawn_id: NDArray[np.int64]
    position: NDArray[np.float64]
    motion_id: NDArray[np.int64]
    seen: NDArray[np.bool_]

    def part(self, start: int, stop: int) -> Self:
        """Return the entries from `start` to `stop`, exclusive."""
        return self.at(slice(start, stop))

    def at(self, index: slice | NDArray[np.int64]) -> Self:
        """Return the entries that `index` selects."""
        return type(self)(**{name: value[index] for name, value in vars(self).items()})

    @property
    def drawn(self) -> bool:
        """Whether spawns and starts are drawn as in training."""
        return bool((self.spawn_id < 0).all())

    def reseeded(self, seed: int) -> Self:
        """Return the same spawns and motions with episode seeds from `seed` on."""
        return replace(self, episode_seed=self.episode_seed - FIRST_SEED + seed)


def split_set(split: str, episodes: int, first_seed: int | None = None) -> EvaluationSet:
    """Return the first `episodes` of a split, one of SPLITS, the first from `first_seed`, by default the split's."""
    seed = SPLITS[split][0] if first_seed is None else first_seed
    if split == "validation":
        return validation_set(seed, episodes)
    return load_evaluation_set().reseeded(seed).part(0, episodes)


def validation_set(seed: int, episodes: int) -> EvaluationSet:
    """Return episodes drawn as in training, each from an episode seed of its own, the first from `seed`."""
    seeds = np.arange(seed, seed + episodes)
    drawn = np.full(episodes, -1)
    nowhere, unknown = np.full((episodes, 2), np.nan), np.zeros(episodes, dtype=bool)
    return EvaluationSet(seeds - seed, seeds, drawn, nowhere, seeds, unknown)


@lru_cache(maxsize=1)
def load_evaluation_set() -> EvaluationSet:
    """Return the committed set."""
    with (files("hrl_comfort.humans") / "evaluation_set.csv").open(encoding="utf-8") as file:
        table = pd.read_csv(file, float_precision="round_trip")
    columns = {name: table[name].to_numpy() for name in COLUMNS if name not in ("x", "y")}
    return EvaluationSet(**columns, position=table[["x", "y"]].to_numpy())
