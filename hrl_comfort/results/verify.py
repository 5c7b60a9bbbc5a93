"""Whether the present code gives the same result: its first episodes at the commit of its record and at this one.

Both are run on one machine, since a product of matrices may differ in its last bit on another processor.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from pandas import DataFrame

from hrl_comfort.config import ConfigError
from hrl_comfort.files.provenance import ROOT, commit, git
from hrl_comfort.files.tables import read_table
from hrl_comfort.results.manifest import Entry
from hrl_comfort.results.record import need_clean_tree, read_record, write_record
from hrl_comfort.results.remake import evaluations_of, run

KEYS = ("episode", "comfort_level", "top", "seed", "shift")
"""Columns that tell an episode of an evaluation, or a shift of a top."""
TOPS, TABLE = "hrl_comfort.benchmarks.tops", "tops.csv"
"""Module that measures tops, and the file for what it measures again."""
MEASURED = {"evaluate": 40, "benchmark": 8, TOPS: 2}
"""Commands that write episodes, each with the number of episodes that are compared: of each task of a benchmark, of
each top."""
SHORT = {
    "hierarchy": (
        "agent.policy_steps=2500",
        "hierarchy.episodes=8",
        "hierarchy.terminal_states_episodes=16",
        "hierarchy.refinement=[]",
    ),
    "meta_controller": ("meta_controller_agent.options=400", "meta_controller_agent.warmup_options=100"),
    "skill": ("agent.policy_steps=2500",),
}
"""Keys of a training that stands in for one whose policies are not kept."""
SHORT_CHOICES = "2048"
"""Choices of such a training by a module: a rollout, from which a top learns once."""


def verify(name: str, entry: Entry) -> str:
    """Run the first episodes of an entry's evaluations of a seed by both commits; say where they differ, or record it.

    The seed is the first whose policies are there. Where no seed has them, the first is trained for a few steps by
    both commits.

    Raises:
      ConfigError: there is nothing to compare, a command fails, or a file has uncommitted changes.
    """
    made, record = need_clean_tree(), read_record(name)
    if record is None or record.commit.endswith("+") or not can_be_verified(entry):
        raise ConfigError(
            f"verify={name}: it has no record of a commit, or no command that writes episodes; give remake={name}"
        )
    each = [Entry(**{**entry.model_dump(), "seeds": [seed]}) for seed in entry.seeds] or [entry]
    evaluated = [[words for words in one.commands("evaluate") if kind(words) in MEASURED] for one in each]
    recorded = [shlex.split(line) for line in record.commands]
    if odd := next((words for found in evaluated for words in found if words not in recorded), None):
        raise ConfigError(f"verify={name}: its record has no command {' '.join(odd)}; give remake={name}")
    kept = next((index for index, found in enumerate(evaluated) if all(map(has_policies, found))), None)
    trained = each[0].commands("train") if kept is None else []
    if kept is None and not trained:
        raise ConfigError(f"verify={name}: its policies are not kept, and it trains none")
    with TemporaryDirectory() as folder, code_of(record.verified or record.commit, Path(folder) / "code") as before:
        runs = [
            first_episodes([*map(shortly, trained)], evaluated[kept or 0], code, Path(folder) / side)
            for side, code in {"before": before, "now": ROOT}.items()
        ]
    for (asked, known), (_, again) in zip(*runs, strict=True):
        if wrong := difference(known, again):
            return f"{asked}: {wrong}"
    if commit() != made:
        raise ConfigError(f"verify={name}: the code changed meanwhile; verify it again")
    write_record(name, record.model_copy(update={"verified": made}))
    return ""


def can_be_verified(entry: Entry) -> bool:
    """Return whether a command of an entry writes episodes."""
    return any(kind(words) in MEASURED for words in entry.commands("evaluate"))


def kind(words: Sequence[str]) -> str:
    """Return the module that a command runs, or the subcommand of hrl-comfort."""
    return words[2] if words[1] == "-m" else words[1]


@contextmanager
def code_of(made: str, folder: Path) -> Iterator[Path]:
    """Check a commit out into a folder for as long; raise ConfigError if it is not in this clone."""
    if git("worktree", "add", "--detach", "--force", str(folder), made) is None:
        raise ConfigError(f"commit {made[:7]} cannot be checked out; if it is not in this clone, fetch it")
    try:
        yield folder
    finally:
        git("worktree", "remove", "--force", str(folder))


def first_episodes(
    trained: Sequence[Sequence[str]], evaluated: Sequence[Sequence[str]], code: Path, folder: Path
) -> list[tuple[str, DataFrame]]:
    """Return a command and its episodes for each evaluation, run by the package in `code`, with runs in `folder`."""
    for words in trained:
        run([placed(word, folder, True) for word in words], code)
    found = []
    for index, words in enumerate(evaluated):
        output = f"runs/{index}"
        again = [placed(word, folder, bool(trained)) for word in shortened(words, output)]
        run(again, code)
        parts = [path / "episodes.csv" for path in evaluations_of(again)]
        files = [folder / output / TABLE] if kind(words) == TOPS else parts
        found += [(" ".join(words), read(path, folder)) for path in files]
    return found


def placed(word: str, folder: Path, trained: bool) -> str:
    """Return a word of a command whose run folder is in `folder` if it is an output, or one of what is `trained`."""
    key, given, value = word.rpartition("=")
    return f"{key}{given}{folder / value}" if value.startswith("runs/") and (trained or key in ("output", "")) else word


def has_policies(words: Sequence[str]) -> bool:
    """Return whether the run folders that a command names as policies are there."""
    given = (word.partition("=")[2] for word in words if word.startswith(("policy=", "policies.", "learned=")))
    asked = [sorted(ROOT.glob(value)) for value in given if value.startswith("runs/")]
    return all(found and all(each.is_file() or any(each.rglob("*.pt")) for each in found) for found in asked)


def shortly(words: Sequence[str]) -> list[str]:
    """Return a training cut to a few steps."""
    if words[1] == "-m":
        return [*words[:4], SHORT_CHOICES, *words[5:]]
    own = SHORT.get(words[2], SHORT["skill"])
    keys = tuple(f"{word.partition('=')[0]}=" for word in own)
    return [*(word for word in words if not word.startswith(keys)), *own]


def shortened(words: Sequence[str], output: str) -> list[str]:
    """Return a command that writes `output`, cut to its first episodes at its first level, none of them of `test`."""
    kept = [word for word in words if not word.startswith(("output=", "levels=[", "episodes="))]
    kept = ["split=validation" if word == "split=test" else word for word in kept]
    if kind(words) == TOPS:
        return [*kept[:3], f"{output}/{TABLE}", str(MEASURED[TOPS]), *kept[5:]]
    asked = next((int(word.partition("=")[2]) for word in words if word.startswith("episodes=")), MEASURED[words[1]])
    kept.append(f"episodes={min(MEASURED[words[1]], asked)}")
    levels = next((word for word in words if word.startswith("levels=")), None)
    first = re.search(r"\d+", levels) if levels else None
    if words[1] == "benchmark":
        kept.append("split=validation")
    if levels or words[1] == "benchmark":
        kept.append(f"levels=[{first[0] if first else '' if levels else 1}]")
    return [*kept, f"output={output}"]


def read(file: Path, folder: Path) -> DataFrame:
    """Return the episodes that have just been written, policies trained in `folder` named from there."""
    rows = read_table(file)
    assert rows is not None, f"{file} has no episodes"
    if "policy" in rows:
        rows["policy"] = rows["policy"].str.replace(f"{folder}/", "")
    return rows


def difference(known: DataFrame, again: DataFrame) -> str:
    """Return the first cell in which episodes differ from the known ones, or nothing."""
    keys = [key for key in KEYS if key in known]
    both = again.merge(known, on=keys, suffixes=("", " before"), how="outer", indicator=True)
    if (both["_merge"] != "both").any():
        return "other episodes"
    for column in known.columns.difference(keys):
        if column not in again:
            return f"no column {column} any more"
        now, before = both[column], both[f"{column} before"]
        unequal = ~((now == before) | (now.isna() & before.isna())).fillna(False).astype(bool)
        if unequal.any():
            row = both[unequal].iloc[0]
            of = f"{row['top']}, shift {row['shift']}" if "top" in known else f"episode {row['episode']}"
            return f"{of}: {column} {row[column]}, before {row[f'{column} before']}"
    return ""
