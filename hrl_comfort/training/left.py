"""The work left in the folder of a training."""

from __future__ import annotations

from enum import Enum
from pathlib import Path

from hrl_comfort.config import HIERARCHY
from hrl_comfort.files.provenance import is_finished


class Left(Enum):
    """The work left in a folder; values are the outcomes that a sweep reports."""

    ALL = "done"
    REST = "resumed"
    NOTHING = "skipped, finished"


def left(folder: Path) -> Left:
    """Return the work left in the folder of a training or a hierarchy; raise ConfigError if it is damaged."""
    if is_finished(folder):
        return Left.NOTHING
    return Left.REST if (folder / HIERARCHY).is_file() or _resumable(folder / "checkpoints") else Left.ALL


def _resumable(checkpoints: Path) -> bool:
    if not checkpoints.is_dir():
        return False
    from hrl_comfort.agents.checkpoint import resumable  # seconds, for torch

    return resumable(checkpoints)
