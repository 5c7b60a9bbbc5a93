"""Interleaved measurements of rates, and tables of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from importlib.util import find_spec
from pathlib import Path

from pandas import DataFrame, Series

from hrl_comfort.analysis.tables import markdown
from hrl_comfort.config import ConfigError
from hrl_comfort.files.tables import write_table

Rate = Callable[[], float]
"""() -> calls a second, measured now."""


def need_peers() -> None:
    """Raise ConfigError if Stable-Baselines3 is not installed."""
    if find_spec("stable_baselines3") is None:
        raise ConfigError("this benchmark needs Stable-Baselines3: pip install 'hrl-comfort[bench]'")


def interleaved(
    path: Path, columns: Sequence[str], sizes: Iterable[int], make: Callable[[int], dict[str, Rate]], rounds: int
) -> DataFrame:
    """Measure the contestants that `make` returns for each size, in turn in every round; write and return the rows.

    `columns` name the size, the contestant, the round and the rate.
    """
    rows = []
    for size in sizes:
        contestants = make(size)
        rows += [(size, name, turn, rate()) for turn in range(rounds) for name, rate in contestants.items()]
    write_table(path, columns, rows)
    return DataFrame(rows, columns=list(columns))


def ratios(frame: DataFrame, reference: str, heading: str, inverse: bool = False) -> str:
    """Return the rows of `interleaved` as a Markdown table: medians, ranges, and ratios to `reference`.

    Ratios are those of each round, `inverse` reference over contestant.
    """
    size, name, turn, rate = frame.columns
    mine = frame.set_index([size, turn])[rate]
    theirs = frame[frame[name] == reference].set_index([size, turn])[rate]
    ratio = mine / theirs.reindex(mine.index)
    frame = frame.assign(ratio=(1 / ratio if inverse else ratio).to_numpy())
    lines = [
        [str(count), str(who), spread(each[rate]), "" if who == reference else spread(each["ratio"], 2)]
        for (count, who), each in frame.groupby([size, name], sort=False)
    ]
    return markdown([size, name, rate.replace("_per_", "/"), heading], lines)


def spread(values: Series, digits: int = 0) -> str:
    """Return the median and the range."""
    return f"{values.median():,.{digits}f} ({values.min():,.{digits}f} to {values.max():,.{digits}f})"
