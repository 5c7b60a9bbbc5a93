"""The record of a result: the commit that made it, and whether what decides it has changed since."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from pathlib import Path

from pydantic import BaseModel

from hrl_comfort.config import ConfigError
from hrl_comfort.files.atomic import write_json
from hrl_comfort.files.documents import read_json
from hrl_comfort.files.provenance import ROOT, commit, git
from hrl_comfort.results.manifest import REFERENCE, Entry, manifest, tracked

RECORDS = REFERENCE / "records"
LEDGER = REFERENCE / "ledger.csv"
"""The published looks at the split `test`."""


class Record(BaseModel):
    """Content of runs/reference/records/NAME.json."""

    commit: str
    """Of the code that made the result; with `+` if files differed from it."""
    verified: str | None = None
    """A later commit that gave the same digits."""
    commands: list[str]


def path_of(name: str) -> Path:
    """Return the file of an entry's record."""
    return RECORDS / f"{name}.json"


def read_record(name: str) -> Record | None:
    """Return the record of an entry, None without one."""
    return read_json(path_of(name), Record) if path_of(name).is_file() else None


def write_record(name: str, record: Record) -> None:
    """Write the record of an entry."""
    RECORDS.mkdir(parents=True, exist_ok=True)
    write_json(path_of(name), record.model_dump())


def state(name: str, entry: Entry) -> str:
    """Return `current`, or why a result is not."""
    if absent := entry.absent():
        return f"missing: {absent[0]}"
    if entry.by_hand:
        return "by hand"
    record = read_record(name)
    if record is None:
        return "no record"
    if record.commit.endswith("+"):
        return "made with uncommitted changes"
    base = record.verified or record.commit
    files = changed(base, entry.decided_by)
    if files is None:
        return f"commit {base[:7]} is not in this clone"
    return f"stale: {len(files)} files changed since {base[:7]}, {files[0]} first" if files else "current"


def changed(base: str, paths: Sequence[str]) -> list[str] | None:
    """Return the files among `paths` that differ from the commit `base` in more than comments, docstrings and layout.

    None if the commit is not in this clone.
    """
    differing = git("diff", "--name-only", base, "--", *paths)
    return None if differing is None else [path for path in differing.splitlines() if not _reworded(base, path)]


def _reworded(base: str, path: str) -> bool:
    """Return whether the statements of a file of Python are those of the commit `base`."""
    before, now = git("show", f"{base}:{path}"), ROOT / path
    if before is None or not now.is_file() or now.suffix != ".py":
        return False
    return _statements(before) == _statements(now.read_text(encoding="utf-8"))


def _statements(source: str) -> str:
    """Return the statements of a source, strings that stand alone left out."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = [each for each in node.body if not _is_docstring(each)]
    return ast.dump(tree)


def _is_docstring(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def need_clean_tree() -> str:
    """Return the commit of the code; raise ConfigError if a tracked file differs that is not itself published."""
    tracked()
    changed = (git("status", "--porcelain", "--untracked-files=no") or "").splitlines()
    names = [line.split()[-1] for line in changed]
    others = [name for name in names if not is_published(name)]
    if others:
        raise ConfigError(f"{others[0]} has uncommitted changes ({len(others)} files); commit them, then publish")
    made = commit()
    if made is None or made.endswith("+"):
        raise ConfigError(f"git does not tell which commit {ROOT} is at")
    return made


def is_published(path: str) -> bool:
    """Return whether a file is an artefact, a record, the ledger, or a page that is filled."""
    own = (ROOT / path).is_relative_to(RECORDS) or ROOT / path == LEDGER
    return own or any(entry.owns(path) or path in entry.pages for entry in manifest().values())
