"""Interleaved measurements of rates, and tables of them."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

from pandas import DataFrame, Series

from hrl_comfort.analysis.tables import markdown
from hrl_comfort.config import ConfigError
from hrl_comfort.files.output import output_file
from hrl_comfort.files.tables import write_table

Size = TypeVar("Size", int, tuple[str, int])
Rate = Callable[[], float]
"""() -> calls a second, measured now."""
SECONDS = 1.0
"""Least duration of a measurement."""
ROUNDS = 7


def given(words: Sequence[str], usage: str, *kinds: Callable[[str], Any]) -> list[Any]:
    """Return the first words of a module's command line, each as a kind; raise ConfigError if they are no such."""
    try:
        return [kind(word) for kind, word in zip(kinds, words[: len(kinds)], strict=True)]
    except ValueError:
        raise ConfigError(f"{' '.join(words) or 'nothing'} is given; give {usage}") from None


def as_command(main: Callable[[Sequence[str]], None]) -> None:
    """Run the `main` of a module with the words of the process; a mistake ends it with one line and exit code 1."""
    try:
        main(sys.argv[1:])
    except ConfigError as error:
        sys.exit(f"hrl-comfort: {error}")


def need_peers() -> None:
    """Raise ConfigError if Stable-Baselines3 is not installed."""
    if find_spec("stable_baselines3") is None:
        raise ConfigError("this benchmark needs Stable-Baselines3: pip install 'hrl-comfort[bench]'")


def rate(step: Callable[[], object], size: int = 1, clock: Callable[[], float] = time.perf_counter) -> float:
    """Return how often a second `step` does something of which it does `size` a call, over at least SECONDS."""
    step()  # warm up
    began, count = clock(), 0
    while count == 0 or clock() - began < SECONDS:
        step()
        count += 1
    return count * size / (clock() - began)


def interleaved(
    path: Path, columns: tuple[str, ...], sizes: Iterable[Size], make: Callable[[Size], dict[str, Rate]]
) -> DataFrame:
    """Measure the contestants that `make` returns for each size, in turn in every round; write and return the rows.

    `columns` name the size, which may be several values, the contestant, the round and the rate.
    """
    rows = []
    with output_file(path):
        for size in sizes:
            contestants: dict[str, Rate] = make(size)
            key: tuple[str | int, ...] = size if isinstance(size, tuple) else (size,)
            rows += [(*key, name, turn, measured()) for turn in range(ROUNDS) for name, measured in contestants.items()]
        write_table(path, columns, rows)
    return DataFrame(rows, columns=list(columns))


def ratios(frame: DataFrame, reference: str, heading: str, inverse: bool = False) -> str:
    """Return the rows of `interleaved` as a Markdown table: medians, ranges, and ratios to `reference`.

    Ratios are those of each round, `inverse` reference over contestant.
    """
    *size, name, turn, rate = frame.columns
    theirs = frame[frame[name] == reference].rename(columns={rate: "theirs"})
    both = frame.merge(theirs[[*size, turn, "theirs"]], on=[*size, turn])
    both["ratio"] = both["theirs"] / both[rate] if inverse else both[rate] / both["theirs"]
    lines = [
        [*map(str, key), spread(each[rate]), "" if key[-1] == reference else spread(each["ratio"], 2)]
        for key, each in both.groupby([*size, name], sort=False)
    ]
    return markdown([*size, name, rate.replace("_per_", "/"), heading], lines)


def spread(values: Series, digits: int = 0) -> str:
    """Return the median and the range."""
    return f"{values.median():,.{digits}f} ({values.min():,.{digits}f} to {values.max():,.{digits}f})"
