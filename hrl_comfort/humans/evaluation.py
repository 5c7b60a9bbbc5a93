"""Evaluation splits: the committed set of 1,000 spawns, motion and episode seeds, and draws of each split's own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import FIRST_SEED, SPLITS

SHARES = {"all": (0.0, 1.0), "train": (0.0, 0.6), "validation": (0.6, 0.8), "test": (0.8, 1.0)}
"""Share of the traits of people, of recordings and of arm starts that belongs to a split. Where people stand and walk
is not parted: a policy that sees them learns bearings by heart if some are missing."""
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
    split: NDArray[np.str_]
    """Name of the split, one of SPLITS."""

    def part(self, start: int, stop: int) -> EvaluationSet:
        """Return the entries from `start` to `stop`, exclusive."""
        return self.at(slice(start, stop))

    def at(self, index: slice | NDArray[np.int64]) -> EvaluationSet:
        """Return the entries that `index` selects."""
        return EvaluationSet(**{name: value[index] for name, value in vars(self).items()})

    @property
    def drawn(self) -> bool:
        """Whether spawns and starts are drawn as in training."""
        return bool((self.spawn_id < 0).all())

    def reseeded(self, seed: int) -> EvaluationSet:
        """Return the same spawns and motions with episode seeds from `seed` on."""
        return replace(self, episode_seed=self.episode_seed - FIRST_SEED + seed)


def split_set(split: str, episodes: int, first_seed: int | None = None) -> EvaluationSet:
    """Return the first `episodes` of a split, one of SPLITS, the first from `first_seed`, by default the split's."""
    seed = SPLITS[split][0] if first_seed is None else first_seed
    if split != "paper":
        return drawn_set(split, seed, episodes)
    return load_evaluation_set().reseeded(seed).part(0, episodes)


def share_of(split: str | None, partitioned: bool) -> tuple[float, float]:
    """Return the share, one of SHARES, that a split draws from; None is training. `test` always keeps to its own."""
    parted = split == "test" or (partitioned and split != "paper")
    return SHARES[(split or "train") if parted else "all"]


def persons_of(split: str | None) -> tuple[float, float]:
    """Return the share of the persons who rate in a split; None is training. `paper` has those of `validation`."""
    return SHARES["validation" if split == "paper" else split or "train"]


def drawn_set(split: str, seed: int, episodes: int) -> EvaluationSet:
    """Return episodes drawn as in training, each from an episode seed of its own, the first from `seed`."""
    seeds = np.arange(seed, seed + episodes)
    drawn = np.full(episodes, -1)
    nowhere, unknown = np.full((episodes, 2), np.nan), np.zeros(episodes, dtype=bool)
    return EvaluationSet(seeds - seed, seeds, drawn, nowhere, seeds, unknown, np.full(episodes, split))


@lru_cache(maxsize=1)
def load_evaluation_set() -> EvaluationSet:
    """Return the committed set, which `make_evaluation_set` wrote."""
    from pandas import read_csv  # half a second

    table = read_csv(Path(__file__).with_name("evaluation_set.csv"), float_precision="round_trip")
    columns = {name: table[name].to_numpy() for name in ("episode", "episode_seed", "spawn_id", "motion_id", "seen")}
    position = np.ascontiguousarray(table[["x", "y"]])
    entries = EvaluationSet(**columns, position=position, split=np.full(len(table), "paper"))
    for column in vars(entries).values():
        column.setflags(write=False)
    return entries
