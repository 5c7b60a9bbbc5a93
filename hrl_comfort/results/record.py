"""The record of a result: the commit that made it, and whether what decides it has changed since."""

from __future__ import annotations

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
    changed = git("diff", "--name-only", base, "--", *entry.decided_by)
    if changed is None:
        return f"commit {base[:7]} is not in this clone"
    files = changed.splitlines()
    return f"stale: {len(files)} files changed since {base[:7]}, {files[0]} first" if files else "current"


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
