"""Making results anew."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, BinaryIO

from pandas import DataFrame

from hrl_comfort.config import ConfigError
from hrl_comfort.config.suite import SUITE
from hrl_comfort.files.atomic import write_atomically
from hrl_comfort.files.provenance import ROOT, commit
from hrl_comfort.files.tables import read_table
from hrl_comfort.results.manifest import PHASES, Entry
from hrl_comfort.results.record import Record, need_clean_tree, write_record

PACKED: Any = {"compression": "zstd", "compression_level": 19, "store_schema": False, "write_statistics": False}
"""Options of parquet. Arrow's own copy of the schema would be half of the file of a small evaluation."""


def remake(name: str, entry: Entry, train: bool, jobs: int) -> None:
    """Run the commands of an entry, with `train` also those that train, and write its record.

    Args:
      name: the entry's name.
      entry: the entry.
      train: train its policies anew.
      jobs: commands of a phase that run at a time.

    Raises:
      ConfigError: a file has uncommitted changes, a policy is not kept and is not to be trained, or a command fails.
    """
    if entry.by_hand:
        raise ConfigError(f"remake={name}: made by hand: {entry.by_hand}")
    made = need_clean_tree()
    if not train and (gone := [each for each in policies_of(entry) if not (ROOT / each).exists()]):
        raise ConfigError(f"remake={name}: {gone[0]} is not kept; say train=true, which trains it again")
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


def run(words: Sequence[str], code: Path | None = None) -> None:
    """Run a command of the manifest in the checkout, with its package or that of another checkout, `code`.

    Raises:
      ConfigError: it fails.
    """
    print(" ".join(words), flush=True)
    program = ["-m", "hrl_comfort", *words[1:], "--overwrite"] if words[0] == "hrl-comfort" else words[1:]
    given = {"OMP_NUM_THREADS": "1"}
    if code not in (None, ROOT):  # else the package of the working directory comes first
        given |= {"PYTHONPATH": str(code), "PYTHONSAFEPATH": "1"}
    done = subprocess.run([sys.executable, *program], cwd=ROOT, env={**os.environ, **given}, stdout=subprocess.DEVNULL)
    if done.returncode:
        raise ConfigError(f"{' '.join(words)} failed")


def policies_of(entry: Entry) -> list[str]:
    """Return the folders and files in `runs` of the policies that the evaluations of an entry name."""
    named = [word.split("=", 1) for words in entry.commands("evaluate") for word in words if "=" in word]
    of_policies = [value for key, value in named if key == "policy" or key.startswith("policies.")]
    return [value for value in of_policies if value.startswith("runs/")]


def output_of(words: Sequence[str]) -> str:
    """Return the value of `output=` among the words of a command, or its last word."""
    return next((word.removeprefix("output=") for word in words if word.startswith("output=")), words[-1])


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
