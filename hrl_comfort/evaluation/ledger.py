"""The ledger of evaluations on the test split: a committed table to which each one appends a line."""

from __future__ import annotations

import csv
import hashlib
import shlex
import sys
from datetime import UTC, datetime
from pathlib import Path

from pandas import DataFrame

from hrl_comfort.config import EvaluateConfig
from hrl_comfort.files.provenance import commit
from hrl_comfort.policies.load import Source, name_of

ROOT = Path(__file__).resolve().parents[2]
FILE = (ROOT / "docs" / "tables" if (ROOT / ".git").exists() else Path.cwd()) / "test_ledger.csv"
"""The ledger of the checkout; of a wheel, in the current folder."""
HEADER = ["utc", "commit", "command", "policy", "task", "human", "episodes", "success", "contact", "unsafe_contact"]


def record(config: EvaluateConfig, policy: Source | None, episodes: DataFrame) -> None:
    """Append policy hashes, commit, command and shares of `episodes` to the ledger."""
    acting = config.policy if policy is None else policy
    sources = [*([acting] if acting is not None else []), *config.policies.values()]
    shares = [f"{episodes[name].astype(bool).mean():.4f}" for name in HEADER[-3:]]
    line = [
        datetime.now(UTC).isoformat(timespec="seconds"),
        commit() or "",
        shlex.join(["hrl-comfort", *sys.argv[1:]]),
        " ".join(map(hash_of, sources)),
        config.task.name,
        config.human.motion,
        len(episodes),
        *shares,
    ]
    new = not FILE.exists()
    with FILE.open("a", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([HEADER, line] if new else [line])


def hash_of(source: Source) -> str:
    """Return the name of a policy and, of a file or run folder, the start of its SHA-256."""
    name = name_of(source)
    file = Path(name.split(":", 1)[-1])
    file = file / "policy.pt" if file.is_dir() else file
    return f"{name}@{hashlib.sha256(file.read_bytes()).hexdigest()[:16]}" if file.is_file() else name
