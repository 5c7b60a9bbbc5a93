"""Random numbers of policies, tops and options that draw: a function of the episode and the control step alone."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.tasks.state import State

OF_POLICIES, OF_ENDS, OF_TOPS = 0, 2**32, 2**33
"""First streams of random policies and random tops, by their seed, and of the ends of options, by their number."""
Words = NDArray[np.uint64]
_GOLDEN, _FIRST, _SECOND = 0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB
"""Constants of SplitMix64 (Steele, Lea, Flood 2014)."""


def uniform(state: State, count: int, stream: int) -> Tensor:
    """Return (N, count) numbers in [0, 1), float64: the same for the same episode, control step and `stream`."""
    key = _mixed(state.key.numpy().astype(np.uint64), stream)
    key = _mixed(key, state.steps.numpy().astype(np.uint64))
    words = _mixed(key[:, None], np.arange(count, dtype=np.uint64))
    return torch.from_numpy((words >> np.uint64(11)).astype(np.float64) * 2.0**-53)


def _mixed(words: Words, counter: int | Words) -> Words:
    """Return the numbers of the generators of state `words` after `counter` further steps."""
    with np.errstate(over="ignore"):
        mixed = words + np.uint64(_GOLDEN) * (np.asarray(counter, dtype=np.uint64) + np.uint64(1))
        mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(_FIRST)
        mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(_SECOND)
    return mixed ^ (mixed >> np.uint64(31))
