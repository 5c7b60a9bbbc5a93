"""The committed evaluation set: 1,000 spawns, motions and seeds; half the spawns unseen in training."""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import FIRST_SEED, ConfigError

COLUMNS = ("episode", "episode_seed", "spawn_id", "x", "y", "motion_id", "seen")
MOTION_STREAM = 7
"""Second word of the key of a motion's random numbers, so that motions share no stream with episodes."""


@dataclass(frozen=True)
class EvaluationSet:
    """Columns of the set, each (E,); position (E, 2) m, cell frame."""

    episode: NDArray[np.int64]
    episode_seed: NDArray[np.int64]
    spawn_id: NDArray[np.int64]
    position: NDArray[np.float64]
    motion_id: NDArray[np.int64]
    seen: NDArray[np.bool_]

    def part(self, start: int, stop: int) -> EvaluationSet:
        """Return entries start to stop; seen and unseen spawns alternate."""
        return EvaluationSet(**{name: value[start:stop] for name, value in vars(self).items()})

    def reseeded(self, seed: int) -> EvaluationSet:
        """Return the same spawns and motions with episode seeds that begin at `seed`."""
        return replace(self, episode_seed=self.episode_seed - FIRST_SEED + seed)


@lru_cache(maxsize=1)
def load_evaluation_set() -> EvaluationSet:
    """Return the committed set.

    Raises:
      ConfigError: the file has been damaged.
    """
    file = files("hrl_comfort.humans") / "evaluation_set.csv"
    return parse_evaluation_set(file.read_text(encoding="utf-8"))


def parse_evaluation_set(text: str) -> EvaluationSet:
    """Return the set that a file of this `text` holds; its arrays are read-only.

    Raises:
      ConfigError: other columns, or a bad line (named).
    """
    header, *lines = list(csv.reader(text.splitlines())) or [[]]
    if tuple(header) != COLUMNS or not lines:
        raise ConfigError(f"people/evaluation_set.csv must have the columns {','.join(COLUMNS)} and an episode")
    whole, places, seen = [], [], []
    for number, line in enumerate(lines, start=2):
        where = f"people/evaluation_set.csv line {number}: {','.join(line)!r}"
        try:
            episode, seed, spawn, x, y, motion, known = line
            row, place = [int(v) for v in (episode, seed, spawn, motion)], [float(x), float(y)]
            seen.append({"True": True, "False": False}[known])
        except (ValueError, KeyError) as error:
            raise ConfigError(f"{where} must hold {','.join(COLUMNS)}, seen True or False") from error
        if row[0] != number - 2 or row[1] < FIRST_SEED or row[2] < 0 or not np.isfinite(place).all():
            raise ConfigError(f"{where} must be episode {number - 2}, with a seed from {FIRST_SEED} and finite x, y")
        whole.append(row)
        places.append(place)
    numbers = np.array(whole, dtype=np.int64)
    entries = EvaluationSet(
        episode=numbers[:, 0].copy(),
        episode_seed=numbers[:, 1].copy(),
        spawn_id=numbers[:, 2].copy(),
        position=np.array(places, dtype=np.float64),
        motion_id=numbers[:, 3].copy(),
        seen=np.array(seen, dtype=bool),
    )
    for column in vars(entries).values():
        column.setflags(write=False)
    return entries
