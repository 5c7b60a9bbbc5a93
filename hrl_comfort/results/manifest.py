"""The manifest of published results: for each the commands that make it, its files and its pages."""

from __future__ import annotations

import shlex
from fnmatch import fnmatch
from functools import cache
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from hrl_comfort.config import ConfigError
from hrl_comfort.config.checks import one_of
from hrl_comfort.files.documents import read_yaml
from hrl_comfort.files.provenance import ROOT, git

FILE = Path(__file__).with_name("manifest.yaml")
REFERENCE = ROOT / "runs" / "reference"
PHASES = ("train", "evaluate", "draw")
PICTURES = (".png", ".gif", ".svg", ".jpg", ".mp4", ".csv", ".json", ".parquet", ".npz", ".pt")
"""Files in docs/ with these suffixes are artefacts too; all tracked files in runs/ are."""
MEASURING = (
    *(f"hrl_comfort/{name}" for name in ("agents", "comfort", "composition", "config", "envs", "evaluation",
                                         "hierarchy", "humans", "policies", "safety", "scene", "sim", "tasks")),
    *(f"hrl_comfort/{name}.py" for name in ("analysis/summary", "benchmarks/suite", "compiled", "instants")),
    "conf", ":!conf/experiment", ":!hrl_comfort/scene/looks", ":!hrl_comfort/policies/hand",
)  # fmt: skip
"""Files that decide an evaluation of given policies, none of them a scripted hand, as pathspecs of git."""


class Entry(BaseModel):
    """A published result: numbers, figures or pictures that are made together."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    about: str
    pages: list[str] = []
    seeds: list[int] = []
    """Training seeds; a command with `{seed}` is run for each."""
    train: list[str] = []
    evaluate: list[str] = []
    draw: list[str] = []
    artefacts: list[str] = Field(min_length=1)
    """Patterns of the files that are committed, from the root of the checkout; `*` also matches `/`."""
    decided_by: list[str] = list(MEASURING)
    """Files of which a change makes the result stale, as pathspecs of git."""
    by_hand: str | None = None
    """Way in which the files are made where no command makes them."""

    def commands(self, phase: str) -> list[list[str]]:
        """Return the words of the commands of a phase, one of PHASES, for each seed."""
        lines: list[str] = getattr(self, phase)
        return [
            shlex.split(line.replace("{seed}", str(seed)))
            for line in lines
            for seed in (self.seeds if "{seed}" in line else [0])
        ]

    def absent(self) -> list[str]:
        """Return the patterns that no file matches."""
        return [pattern for pattern in self.artefacts if not any(fnmatch(path, pattern) for path in _beside(pattern))]

    def owns(self, path: str) -> bool:
        """Return whether a file, from the root of the checkout, is an artefact of this entry."""
        return any(fnmatch(path, pattern) for pattern in self.artefacts)


def _beside(pattern: str) -> list[str]:
    """Return the files where those of a pattern are, from the root of the checkout."""
    folder = (ROOT / pattern.partition("*")[0]).parent if "*" in pattern else (ROOT / pattern).parent
    return [str(path.relative_to(ROOT)) for path in folder.rglob("*") if path.is_file()]


@cache
def manifest() -> dict[str, Entry]:
    """Return the entries of manifest.yaml by name."""
    return {str(name): Entry(**values) for name, values in read_yaml(FILE)[1].items()}


def entry(key: str, name: str) -> Entry:
    """Return the entry `name`, the value of the key `key`; raise ConfigError if there is none."""
    one_of(key, name, tuple(manifest()))
    return manifest()[name]


def tracked() -> list[str]:
    """Return the artefacts that git tracks, from the root of the checkout.

    Raises:
      ConfigError: the package is not in a checkout.
    """
    listed = git("ls-files", "runs", "docs")
    if listed is None:
        raise ConfigError(f"results are published from a checkout; {ROOT} is none")
    return [name for name in listed.splitlines() if is_artefact(name)]


def is_artefact(path: str) -> bool:
    """Return whether a tracked file is one that needs an entry."""
    inside = path.startswith("runs/") and not path.endswith(".gitkeep")
    return inside or (path.startswith("docs/") and path.endswith(PICTURES))
