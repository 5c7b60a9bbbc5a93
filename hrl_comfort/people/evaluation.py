"""The committed evaluation set: 1,000 spawns, motions and seeds; half of the spawns never seen in training."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import ConfigError

COLUMNS = ("episode", "episode_seed", "spawn_id", "x", "y", "motion_id", "seen")
FIRST_SEED = 1_000_000
"""Evaluation seeds begin here; training seeds stay below."""
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

    def first(self, count: int) -> EvaluationSet:
        """Return the first `count` entries; seen and unseen alternate."""
        return EvaluationSet(**{name: value[:count] for name, value in vars(self).items()})


@lru_cache(maxsize=1)
def load_evaluation_set() -> EvaluationSet:
    """Return the committed set.

    Raises:
      ConfigError: the file has been damaged.
    """
    with (files("hrl_comfort.people") / "evaluation_set.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    if not rows or tuple(rows[0]) != COLUMNS:
        raise ConfigError(f"people/evaluation_set.csv must have the columns {','.join(COLUMNS)}")
    return EvaluationSet(
        episode=np.array([int(r["episode"]) for r in rows]),
        episode_seed=np.array([int(r["episode_seed"]) for r in rows]),
        spawn_id=np.array([int(r["spawn_id"]) for r in rows]),
        position=np.array([[float(r["x"]), float(r["y"])] for r in rows]),
        motion_id=np.array([int(r["motion_id"]) for r in rows]),
        seen=np.array([r["seen"] == "True" for r in rows]),
    )
