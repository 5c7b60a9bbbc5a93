"""Evaluation splits: the committed set of 1,000 spawns, motion and episode seeds, and draws in parts of the world."""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import FIRST_SEED, SPLITS, ConfigError

FILE = "humans/evaluation_set.csv"
COLUMNS = ("episode", "episode_seed", "spawn_id", "x", "y", "motion_id", "seen")
SHARES = {"all": (0.0, 1.0), "train": (0.0, 0.6), "validation": (0.6, 0.8), "test": (0.8, 1.0)}
"""Share of everything that is parted that belongs to a split: of the full turn around the robot, of the traits of
people, of recordings, of arm starts."""
FIRST_BEARING_RAD = np.radians(31.0)
"""Bearing at which the sector of `train` begins: it holds two tables, that of `test` the third, `validation` none."""
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
    """Return the share of the world that a split draws from; None is training. `test` always keeps to its own."""
    parted = split == "test" or (partitioned and split != "paper")
    return SHARES[(split or "train") if parted else "all"]


def in_sector(position: NDArray[np.float64], share: tuple[float, float]) -> NDArray[np.bool_]:
    """Return whether positions (n, 2) m lie in the sector around the robot that is this share of the full turn."""
    bearing = np.arctan2(position[:, 1], position[:, 0]) - FIRST_BEARING_RAD
    turn = np.minimum(bearing / (2 * np.pi) % 1.0, 1.0 - 1e-9)
    return np.asarray((share[0] <= turn) & (turn < share[1]))


def drawn_set(split: str, seed: int, episodes: int) -> EvaluationSet:
    """Return episodes drawn as in training, each from an episode seed of its own, the first from `seed`."""
    seeds = np.arange(seed, seed + episodes)
    drawn = np.full(episodes, -1)
    nowhere, unknown = np.full((episodes, 2), np.nan), np.zeros(episodes, dtype=bool)
    return EvaluationSet(seeds - seed, seeds, drawn, nowhere, seeds, unknown, np.full(episodes, split))


@lru_cache(maxsize=1)
def load_evaluation_set() -> EvaluationSet:
    """Return the committed set; raise ConfigError if its file is damaged."""
    file = files("hrl_comfort.humans") / "evaluation_set.csv"
    return parse_evaluation_set(file.read_text(encoding="utf-8"))


def parse_evaluation_set(text: str) -> EvaluationSet:
    """Return the set in the CSV `text`.

    Raises:
      ConfigError: wrong columns, or a bad line (named).
    """
    header, *lines = list(csv.reader(text.splitlines())) or [[]]
    if tuple(header) != COLUMNS or not lines:
        raise ConfigError(f"{FILE} must have the columns {','.join(COLUMNS)} and at least one episode")
    rows = []
    for number, line in enumerate(lines, start=2):
        try:
            episode, seed, spawn, x, y, motion, known = line
            whole, place = [int(v) for v in (episode, seed, spawn, motion)], (float(x), float(y))
            seen = {"True": True, "False": False}[known]
            valid = whole[0] == number - 2 and whole[1] >= FIRST_SEED and whole[2] >= 0 and np.isfinite(place).all()
        except (ValueError, KeyError):
            valid = False
        if not valid:
            raise ConfigError(
                f"{FILE} line {number}: {','.join(line)!r} must hold {','.join(COLUMNS)}: episode {number - 2}, "
                f"a seed from {FIRST_SEED}, a spawn from 0, finite x and y (m), a motion, seen True or False"
            )
        rows.append((*whole[:3], place, whole[3], seen))
    entries = EvaluationSet(*map(np.array, [*zip(*rows, strict=True), ["paper"] * len(rows)]))
    for column in vars(entries).values():
        column.setflags(write=False)
    return entries
