"""Publishing looks at the split `test`: lines of this machine's ledger into the committed one."""

from __future__ import annotations

import shlex

from pandas import DataFrame, concat, read_csv

from hrl_comfort.evaluation import ledger
from hrl_comfort.files.atomic import write_text
from hrl_comfort.files.provenance import ROOT
from hrl_comfort.results.manifest import manifest
from hrl_comfort.results.record import LEDGER


def words_of(command: str) -> tuple[str, ...]:
    """Return what a command asks for: its words in order, without flags, `output=` and tops that it adds to a table."""
    words = [word for word in shlex.split(command) if not word.startswith(("--", "output=", "learned="))]
    return tuple(sorted(words))


def published() -> set[tuple[str, ...]]:
    """Return the commands of the manifest, as `words_of`."""
    return {words_of(shlex.join(words)) for entry in manifest().values() for words in entry.commands("evaluate")}


def is_kept(line: dict[str, str], commands: set[tuple[str, ...]]) -> bool:
    """Return whether a look is published: by a command of the manifest, of policies that are those in the tree.

    Policies that are not kept there cannot differ from it.
    """
    policies = [policy.rpartition("@") for policy in line["policy"].split() if "@" in policy]
    files = {str(ROOT / name): digest for name, _, digest in policies}
    kept = all(ledger.hash_of(file) in (file, f"{file}@{digest}") for file, digest in files.items())
    return kept and words_of(line["command"]) in commands


def merge() -> list[str]:
    """Add this machine's looks to the committed ledger, prune it, and return a line for each that is refused.

    A look from a tree with uncommitted changes is refused. An earlier one of that kind gives way to a clean one by the
    same command.
    """
    commands = published()
    old = _read(LEDGER)
    new = _read(ledger.FILE).groupby("look", sort=False).last().reset_index() if ledger.FILE.is_file() else old[:0]
    new = new[[is_kept(line, commands) for line in new.to_dict("records")]] if len(new) else new
    dirty = new["commit"].str.endswith("+")
    refused = [f"not published, its tree had uncommitted changes: {command}" for command in new["command"][dirty]]
    new = new[~dirty & ~new["look"].isin(old["look"])]
    again = set(map(words_of, new["command"]))
    keep = [
        is_kept(line, commands) and not (line["commit"].endswith("+") and words_of(line["command"]) in again)
        for line in old.to_dict("records")
    ]
    whole = concat([old[keep], new])[list(ledger.HEADER)]
    write_text(LEDGER, whole.to_csv(index=False, lineterminator="\n"))
    return refused


def _read(path: object) -> DataFrame:
    return read_csv(str(path), dtype=str, keep_default_na=False)
