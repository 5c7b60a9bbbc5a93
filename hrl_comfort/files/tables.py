"""Tables of a run folder: their columns, and reading and writing them.

A table is a CSV, or a parquet of the same name. An empty cell is a missing value, never a zero.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pandas import DataFrame, Series
from pyarrow.parquet import ParquetFile

from hrl_comfort.config.checks import FARTHEST
from hrl_comfort.files.atomic import write_text
from hrl_comfort.files.documents import damaged
from hrl_comfort.files.reading import read_text
from hrl_comfort.files.versions import COLUMNS

Floats = NDArray[np.float64]
DTYPES = {
    "int": "int64", "int?": "Int64", "float": "float64", "float?": "float64",
    "bool": "bool", "bool?": "boolean", "text": "str", "text?": "str",
}  # fmt: skip
"""Kind of a column, with `?` where values may be missing, to its pandas dtype."""
NEEDED: dict[str, dict[str, str]] = {
    "metrics": dict.fromkeys(("policy_steps", "episodes"), "int")
    | dict.fromkeys(("success", "return", "steps", "precision_m"), "float?"),
    "meta_controller_metrics": dict.fromkeys(("options", "episodes"), "int")
    | dict.fromkeys(("success", "placed", "return", "steps"), "float?"),
    "timing": {"seconds": "float"},
    "episodes": {"episode": "int", "success": "bool"},
    "checkpoints": {"policy_steps": "int", "success": "float"},
    "grid": {"policy_steps": "int"} | dict.fromkeys(("success", "contact", "unsafe_contact"), "float"),
    "options": {"episode": "int", "option": "text", "termination": "text", "start_step": "int", "end_step": "int"},
    "paths": dict.fromkeys(("episode", "step"), "int")
    | dict.fromkeys(("tcp_x", "tcp_y", "tcp_z"), "float")
    | dict.fromkeys(("human_x", "human_y", "human_distance_m"), "float?"),
    "setpoints": {"time_s": "float"},
    "handover_episodes": {"subtask": "text", "start": "text", "episode": "int", "spawn_id": "int", "success": "bool"},
    "chain": {"options": "int", "success": "float"},
}
"""Columns that a table cannot do without, by the stem of its file."""
OF_CHECKPOINTS = {"task": "text?", "human": "text?", "split": "text?", "comfort_level": "int?"}
KNOWN: dict[str, dict[str, str]] = {
    "metrics": {"stage": "text?"},
    "episodes": dict.fromkeys(("task", "policy", "split", "object", "human", "other_collision"), "text?")
    | dict.fromkeys(("train_seed", "episode_seed", "spawn_id", "motion_id", "person_id", "comfort_level"), "int?")
    | dict.fromkeys(
        ("steps", "policy_steps", "objects_placed", "protective_stops", "human_beyond_bound", "drops"), "int?"
    )
    | dict.fromkeys(("seen", "contact", "unsafe_contact", "truncated", "object_lost", "diverged"), "bool?"),
    "checkpoints": OF_CHECKPOINTS,
    "grid": OF_CHECKPOINTS,
    "options": {"comfort_level": "int?", "cause": "text?"},
}
"""Columns of a kind of their own that may be absent; all others are `float?`."""
MOST_CELLS = 5 * 10**7
"""Largest parquet table: 0.4 GB of floats."""
MOST_COLUMNS = 5000
INT_END = 2.0**63
"""First whole number that int64 does not hold."""
TRUTH = {"true": "1", "false": "0"}


def read_table(path: Path) -> DataFrame | None:
    """Return the table `path` (.csv) or its .parquet; None where neither is there or no row is in it.

    Raises:
      ConfigError: the table is damaged; the error names file, line and reason.
    """
    file = next((each for each in (path, path.with_suffix(".parquet")) if each.is_file()), None)
    if file is None:
        return None
    try:
        frame = _read_parquet(file) if file.suffix == ".parquet" else _read_csv(file)
    except (ValueError, OSError, csv.Error) as error:  # pyarrow's errors are of the first two classes
        raise damaged(file, error) from None
    if path.stem == "episodes":
        frame = frame.rename(columns=COLUMNS)
    return conform(frame, path.stem, file) if len(frame) else None


def _read_parquet(path: Path) -> DataFrame:
    """Return the table of a parquet file; raise ValueError where it has more than MOST_CELLS or MOST_COLUMNS."""
    with ParquetFile(path) as file:
        cells = file.metadata.num_rows * file.metadata.num_columns
        if cells > MOST_CELLS:
            raise ValueError(f"it unpacks to {cells} cells; at most {MOST_CELLS} are allowed")
        if file.metadata.num_columns > MOST_COLUMNS:
            raise ValueError(f"it has {file.metadata.num_columns} columns; at most {MOST_COLUMNS} are read")
    return pd.read_parquet(path)


def _read_csv(path: Path) -> DataFrame:
    """Return the cells of a CSV; raise ValueError where it is not UTF-8 or a line is cut short."""
    text = read_text(path)
    lines = text.splitlines()
    if not lines:
        raise ValueError("it is empty")
    if (count := lines[0].count(",") + 1) > MOST_COLUMNS:
        raise ValueError(f"it has {count} columns; at most {MOST_COLUMNS} are read")
    cells = [line.count(",") for line in lines] if '"' not in text else [len(row) - 1 for row in csv.reader(lines)]
    for number, count in enumerate(cells, start=1):
        if count != cells[0]:
            raise ValueError(f"line {number} has {count + 1} cells, the header {cells[0] + 1}")
    if not text.endswith("\n"):
        raise ValueError(f"line {len(lines)} is cut short")
    text_columns = {name: "str" for kinds in KNOWN.values() for name, kind in kinds.items() if kind == "text?"}
    return pd.read_csv(io.StringIO(text), dtype=text_columns, keep_default_na=False, na_values=["", "nan"])


def conform(frame: DataFrame, name: str, where: object) -> DataFrame:
    """Return the table called `name` with every column in its dtype.

    Raises:
      ConfigError: a needed column is missing, or a cell has another type; the error names `where`.
    """
    needed, known = NEEDED.get(name), KNOWN.get(name, {})
    if needed is None:
        return frame
    missing = [column for column in needed if column not in frame]
    if missing:
        raise damaged(Path(str(where)), f"it lacks the column {missing[0]}")
    kinds = {column: {**known, **needed}.get(column, "float?") for column in frame}
    try:
        most = FARTHEST if name == "paths" else math.inf  # coordinates, which are drawn
        return DataFrame({column: _typed(frame[column], kind, most) for column, kind in kinds.items()})
    except ValueError as error:
        raise damaged(Path(str(where)), error) from None


def _typed(values: Series, kind: str, most: float) -> Series:
    """Return a column in the dtype of its kind, fractions within ±`most`; raise ValueError at the first bad cell."""
    numeric = pd.api.types.is_numeric_dtype(values.dtype)
    there = (values.notna() if numeric else values.notna() & (values.astype("str") != "")).to_numpy(dtype=bool)
    if not kind.endswith("?"):
        _refuse(values, ~there, "is missing")
    kind_of = kind.rstrip("?")
    if kind_of == "text":
        return values.where(there).astype("str")
    number = values
    if not numeric:
        number = pd.to_numeric(values.astype("str").str.strip().str.lower().replace(TRUTH), errors="coerce")
    found = number.to_numpy(dtype=float, na_value=np.nan)
    _refuse(values, there & np.isnan(found), "is not a number" if kind_of != "bool" else "is neither True nor False")
    _refuse(values, np.isinf(found), "is not finite")
    if kind_of == "bool":
        _refuse(values, there & (found != 0) & (found != 1), "is neither True nor False")
    if kind_of == "float":
        _refuse(values, np.abs(found) > most, f"is beyond ±{most:g}")
    if kind_of == "int":
        _refuse(values, there & (found != np.round(found)), "is not a whole number")
        _refuse(values, np.abs(found) >= INT_END, "is beyond 64 bits")
    return Series(found, index=values.index, name=values.name).astype(DTYPES[kind])


def _refuse(values: Series, bad: NDArray[np.bool_], reason: str) -> None:
    """Raise ValueError that names the first cell that is `bad` (n,), if there is one."""
    if bad.any():
        place = int(np.flatnonzero(bad)[0])
        cell = values.iloc[place]
        raise ValueError(f"line {place + 2}: {values.name}={'' if pd.isna(cell) else cell!s:.60} {reason}")


def column(frame: DataFrame, name: str) -> Floats:
    """Return a column as floats (n,), NaN where a value or the whole column is missing."""
    if name not in frame:
        return np.full(len(frame), np.nan)
    return np.array(frame[name].to_numpy(dtype=np.float64, na_value=np.nan))


def write_table(path: Path, header: Sequence[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write a CSV in one step; None becomes an empty cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    write_text(path, text.getvalue())


class GrowingTable:
    """A CSV that a training extends row by row."""

    def __init__(self, path: Path, header: Sequence[str]) -> None:
        self._path, self._header = path, header

    def begin(self, rows: int) -> None:
        """Cut the file back to its first `rows` rows; raise ConfigError if it is damaged or holds fewer."""
        try:
            if rows and not self._path.is_file():
                raise FileNotFoundError("it does not exist")
            lines = read_text(self._path).splitlines(keepends=True)[1 : rows + 1] if rows else []
        except (OSError, ValueError) as error:
            raise damaged(self._path, error) from None
        if len(lines) < rows:
            raise damaged(self._path, f"it holds {len(lines)} rows; its checkpoint was written after {rows}")
        write_text(self._path, "".join([",".join(self._header) + "\n", *lines]))

    def append(self, cells: Iterable[Any]) -> None:
        """Write a row; None becomes an empty cell."""
        with self._path.open("a", newline="") as file:
            csv.writer(file, lineterminator="\n").writerow(cells)


def records_of(rows: Iterable[Mapping[str, Any]], name: str) -> DataFrame:
    """Return rows of cells as the table called `name`."""
    return conform(DataFrame(list(rows)), name, name)
