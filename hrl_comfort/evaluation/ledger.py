"""The ledger of looks at the split `test`: `open_split` is the only door to a split, and writes a line as it opens."""

from __future__ import annotations

import csv
import hashlib
import secrets
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from pandas import DataFrame

from hrl_comfort.config import EvaluateConfig
from hrl_comfort.files.provenance import ROOT, commit
from hrl_comfort.humans import EvaluationSet, split_set
from hrl_comfort.policies.load import Source, name_of

FILE = (ROOT if (ROOT / ".git").exists() else Path.cwd()) / "runs" / "ledger.csv"
"""The ledger of this machine, beside its runs and untracked; `hrl-comfort results` publishes lines of it."""
SHARES = ("success", "contact", "unsafe_contact")
"""Columns of episodes.csv whose shares a look, and a checkpoint, is told by."""
HEADER = ("look", "utc", "commit", "command", "policy", "task", "human", "episodes", *SHARES)
"""A look has a line when it is opened, without shares, and another with them when its episodes are over."""


@dataclass(frozen=True)
class Look:
    """The opened episodes of a split."""

    entries: EvaluationSet
    line: dict[str, object] | None
    """The look's line in the ledger; None if the split is not `test`."""

    def completed(self, episodes: DataFrame | None = None) -> None:
        """Append the line of a look whose episodes are over, with the shares of `episodes` where it has the table."""
        if self.line is not None:
            shares = {} if episodes is None else {name: f"{episodes[name].astype(bool).mean():.4f}" for name in SHARES}
            _append({**self.line, "episodes": self.line["episodes"] if episodes is None else len(episodes), **shares})


def open_split(config: EvaluateConfig, policy: Source | None = None, further: Sequence[Source] = ()) -> Look:
    """Return the episodes that `config` asks for; a look at `test` has its line before the first of them begins.

    Args:
      config: the evaluation.
      policy: acts in place of the policy that `config` names.
      further: policies and tops that act, too.
    """
    line: dict[str, object] | None = None
    if config.split == "test":
        acting = config.policy if policy is None else policy
        sources = [*([acting] if acting is not None else []), *config.policies.values(), *further]
        line = {
            "look": secrets.token_hex(4),
            "utc": datetime.now(UTC).isoformat(timespec="seconds"),
            "commit": commit() or "",
            "command": shlex.join([*_program(), *sys.argv[1:]]),
            "policy": " ".join(map(hash_of, sources)),
            "task": config.task.name,
            "human": config.human.motions,
            "episodes": config.episodes * max(1, len(config.levels)),
        }
        _append(line)
    return Look(split_set(config.split, config.episodes, config.first_seed), line)


def _program() -> list[str]:
    """Return how this process was called, without what it was given."""
    called = sys.orig_argv[1:3]
    own = called[:1] == ["-m"] and called[-1].startswith("hrl_comfort.")
    return ["python", *called] if own else ["hrl-comfort"]


def _append(line: dict[str, object]) -> None:
    FILE.parent.mkdir(parents=True, exist_ok=True)
    with FILE.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, HEADER, lineterminator="\n")
        if not file.tell():
            writer.writeheader()
        writer.writerow(line)


def hash_of(source: Source) -> str:
    """Return the name of a policy and, of a file or run folder, the start of its SHA-256."""
    name = name_of(source)
    file = Path(name.split(":", 1)[-1])
    inside = (file / each for each in ("policy.pt", "meta_controller.pt", "model.zip"))
    file = next((each for each in inside if each.is_file()), file)
    return f"{name}@{hashlib.sha256(file.read_bytes()).hexdigest()[:16]}" if file.is_file() else name
