"""Making results anew, and comparing the first episodes of one with those committed."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

from pandas import DataFrame

from hrl_comfort.config import ConfigError
from hrl_comfort.config.suite import SUITE
from hrl_comfort.evaluation.rollout import BATCH
from hrl_comfort.files.atomic import write_atomically
from hrl_comfort.files.provenance import ROOT, commit
from hrl_comfort.files.tables import read_table
from hrl_comfort.results.manifest import PHASES, Entry
from hrl_comfort.results.record import Record, need_clean_tree, read_record, write_record

KEYS = ["episode", "comfort_level"]
"""Columns that tell an episode of an evaluation."""
PACKED: Any = {"compression": "zstd", "compression_level": 19}
MEASURED = ("evaluate", "benchmark")
"""Commands that write episodes."""


def remake(name: str, entry: Entry, train: bool, jobs: int) -> None:
    """Run the commands of an entry, with `train` also those that train, and write its record.

    Args:
      name: the entry's name.
      entry: the entry.
      train: train its policies anew.
      jobs: commands of a phase that run at a time.

    Raises:
      ConfigError: a file has uncommitted changes, or a command fails.
    """
    if entry.by_hand:
        raise ConfigError(f"remake={name}: made by hand: {entry.by_hand}")
    made = need_clean_tree()
    lines = []
    for phase in PHASES if train else PHASES[1:]:
        commands = entry.commands(phase)
        for word in [word for words in commands if words[0] == "python" for word in words if word in entry.artefacts]:
            (ROOT / word).unlink(missing_ok=True)  # modules such as `tests.safety.persistent` go on with what is there
        with ThreadPoolExecutor(jobs) as pool:
            list(pool.map(run, commands))
        for words in commands:
            for folder in evaluations_of(words):
                compact(folder)
        lines += [" ".join(words) for words in commands]
    if commit() != made:
        raise ConfigError(f"remake={name}: the code changed meanwhile; commit it, then make the result again")
    write_record(name, Record(commit=made, commands=lines))


def run(words: Sequence[str]) -> None:
    """Run a command of the manifest in the checkout; raise ConfigError if it fails."""
    print(" ".join(words), flush=True)
    program = ["-m", "hrl_comfort", *words[1:], "--overwrite"] if words[0] == "hrl-comfort" else words[1:]
    done = subprocess.run(
        [sys.executable, *program], cwd=ROOT, env={**os.environ, "OMP_NUM_THREADS": "1"}, stdout=subprocess.DEVNULL
    )
    if done.returncode:
        raise ConfigError(f"{' '.join(words)} failed")


def output_of(words: Sequence[str]) -> str:
    """Return the value of `output=` among the words of a command, or its last word."""
    return next((word.removeprefix("output=") for word in words if word.startswith("output=")), words[-1])


def has_policies(words: Sequence[str]) -> bool:
    """Return whether the run folders that a command names as policies are there."""
    given = (word.partition("=")[2] for word in words if word.startswith(("policy=", "policies.")))
    return all((ROOT / value).exists() for value in given if value.startswith("runs/"))


def evaluations_of(words: Sequence[str]) -> list[Path]:
    """Return the folders of evaluations that a command writes: its output, or that of each part of the benchmark."""
    output = Path(output_of(words))
    if words[1] != "benchmark":
        return [output]
    asked = next((word for word in words if word.startswith("suite=")), "")
    return [output / part for part in SUITE if part in asked or not asked]


def compact(folder: Path) -> None:
    """Keep the episodes of an evaluation as parquet, a tenth of the size of their CSV."""
    file = ROOT / folder / "episodes.csv"
    if file.is_file() and (rows := read_table(file)) is not None:
        write_atomically(file.with_suffix(".parquet"), lambda target: pack(rows, target))
        file.unlink()


def pack(rows: DataFrame, target: BinaryIO) -> None:
    """Write episodes as parquet, bytes of numbers grouped by significance, which saves an eighth; no digit is lost."""
    split = [name for name in rows if rows[name].dtype == "float64"]
    whole = [name for name in rows if name not in split]
    rows.to_parquet(target, index=False, use_dictionary=whole, use_byte_stream_split=split, **PACKED)


def verify(name: str, entry: Entry) -> str:
    """Run the first batch of an entry's evaluations of a seed again; say where it differs, or record it.

    The seed is the first whose policies are there. Equal digits need the same machine too: a product of matrices may
    differ in its last bit on another processor.

    Raises:
      ConfigError: there is nothing to compare with, no seed has its policies, or a file has uncommitted changes.
    """
    made, record = need_clean_tree(), read_record(name)
    each = [Entry(**{**entry.model_dump(), "seeds": [seed]}) for seed in entry.seeds] or [entry]
    of_seeds = [[words for words in one.commands("evaluate") if words[1] in MEASURED] for one in each]
    commands = next((found for found in of_seeds if all(map(has_policies, found))), None)
    if commands is None:
        raise ConfigError(f"verify={name}: its policies are not kept; give remake={name} train=true")
    known = {
        folder: read_table(ROOT / folder / "episodes.csv") for words in commands for folder in evaluations_of(words)
    }
    if record is None or not commands or any(rows is None for rows in known.values()):
        raise ConfigError(f"verify={name}: it has no committed episodes and record; give remake={name}")
    for words in commands:
        with TemporaryDirectory() as folder:
            again = [*shortened(words), f"output={folder}/again"]
            run(again)
            for made_then, made_now in zip(evaluations_of(words), evaluations_of(again), strict=True):
                if wrong := difference(known[made_then], read(made_now)):
                    return f"{made_then}: {wrong}"
    write_record(name, record.model_copy(update={"verified": made}))
    return ""


def read(folder: Path) -> DataFrame:
    """Return the episodes of an evaluation that has just been written."""
    rows = read_table(folder / "episodes.csv")
    assert rows is not None, f"{folder} has no episodes"
    return rows


def shortened(words: Sequence[str]) -> list[str]:
    """Return a command without its output, cut to its first batch of episodes at its first level."""
    kept = [word for word in words if not word.startswith(("output=", "levels=[", "episodes="))]
    asked = next((word for word in words if word.startswith("episodes=")), None)
    levels = next((word for word in words if word.startswith("levels=")), None)
    first = re.search(r"\d+", levels) if levels else None
    if asked:
        kept.append(f"episodes={min(BATCH, int(asked.partition('=')[2]))}")
    if levels or words[1] == "benchmark":
        kept.append(f"levels=[{first[0] if first else '' if levels else 1}]")
    return kept


def difference(known: DataFrame | None, again: DataFrame) -> str:
    """Return the first cell in which episodes differ from the known ones, or nothing."""
    assert known is not None
    both = again.merge(known, on=KEYS, suffixes=("", " before"), how="left", indicator=True)
    if (both["_merge"] != "both").any():
        return "episodes that were not there before"
    for column in known.columns.difference(KEYS):
        if column not in again:
            return f"no column {column} any more"
        now, before = both[column], both[f"{column} before"]
        unequal = ~((now == before) | (now.isna() & before.isna())).fillna(False).astype(bool)
        if unequal.any():
            row = both[unequal].iloc[0]
            return f"episode {row['episode']}: {column} {row[column]}, before {row[f'{column} before']}"
    return ""
