"""Streams of random numbers, each of a key of its own."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.random.bit_generator import ISeedSequence
from numpy.typing import NDArray


class Key(ISeedSequence):
    """Key of a Philox generator, two numbers of 64 bits.

    `Philox(key=...)` is given the same, but takes three times as long: it asks the system for a seed that it drops.
    """

    def __init__(self, *words: int) -> None:
        self._words = words

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> NDArray[Any]:
        """Return the key, of which numpy asks for two words of uint64."""
        return np.array(self._words, dtype=dtype)


def random_stream(first: int, second: int) -> np.random.Generator:
    """Return the generator of the stream of a key, two numbers below 2⁶⁴."""
    key = Key(first, second)
    return np.random.Generator(np.random.Philox(key))  # type: ignore[arg-type]  # numpy's stubs know SeedSequence alone
