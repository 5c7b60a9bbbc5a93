"""Checks of what clients pass to an environment: seeds, actions, whole numbers and reset options."""

from __future__ import annotations

import operator
import reprlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import SPLITS, VALIDATION_SEED, ConfigError
from hrl_comfort.config.checks import between, one_of
from hrl_comfort.humans import EvaluationSet, split_set

SEEDS = 2**32
"""Number of seeds a client may pass; Stable-Baselines3 and TorchRL draw theirs from all of them."""
_FREE = 2**31 + VALIDATION_SEED
"""First of the episode seeds that no split uses."""


def whole(name: str, value: object) -> int:
    """Return `value` as an int; raise ConfigError unless it is a whole number."""
    try:
        return operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        raise ConfigError(f"{name}={_short(value)} must be a whole number") from None


def episode_seed(seed: object) -> int:
    """Return the episode seed of a client's `seed`, from 0 to SEEDS - 1.

    Those below VALIDATION_SEED are episode seeds of training. The others are mapped above those of every split, so
    that no seed of a client draws an episode of an evaluation.

    Raises:
      ConfigError: not such a whole number.
    """
    number = int(seed) if isinstance(seed, int | np.integer) else -1
    if not 0 <= number < SEEDS:
        raise ConfigError(f"seed={_short(seed)} must be a whole number from 0 to {SEEDS - 1}")
    return number if number < VALIDATION_SEED else _FREE + (number - VALIDATION_SEED) % (SEEDS - _FREE)


def checked_action(action: object, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return `action` as float64 of `shape`; values beyond [-1, 1] are clipped when it is applied.

    Raises:
      ValueError: not numbers of `shape`, or one of them is not finite.
    """
    try:
        values = np.asarray(action, dtype=np.float64)
    except (TypeError, ValueError):
        values = np.empty(0)
    if action is None or values.shape != shape or not np.isfinite(values).all():
        raise ValueError(f"action={_short(action)} must be {shape} finite numbers, each in [-1, 1]")
    return values


def replayed(options: Mapping[str, Any] | None, rows: int) -> EvaluationSet | None:
    """Return the episodes of a split that reset `options` ask for, one of each row; None without options.

    `{"episode": k, "split": "validation"}` are the episodes k, k + 1, ... as `hrl-comfort evaluate` numbers them;
    `k` may also be one number a row.

    Raises:
      ConfigError: an unknown option, or an episode that the split does not have.
    """
    if not options:
        return None
    if set(options) != {"episode", "split"}:
        raise ConfigError(
            f"options={_short(dict(options))} must be {{'episode': NUMBER, 'split': SPLIT}}; "
            f"the splits are paper, train, validation"
        )
    split, asked = options["split"], options["episode"]
    one_of("options['split']", split, tuple(name for name in SPLITS if name != "test"))  # the ledger's
    listed = list(asked) if isinstance(asked, list | tuple | np.ndarray) else None
    if listed is not None and len(listed) != rows:
        raise ConfigError(f"options['episode']={_short(asked)} must be one number, or {rows}, one an environment")
    first = 0 if listed is not None else whole("options['episode']", asked)
    chosen = [whole("options['episode']", each) for each in listed or range(first, first + rows)]
    last = SPLITS[split][2] - 1
    for episode in chosen:
        between("options['episode']", episode, 0, last)
    return split_set(split, last + 1).at(np.array(chosen))


def _short(value: object) -> str:
    return " ".join(reprlib.repr(value).split())
