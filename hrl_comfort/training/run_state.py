"""Whether the training in a folder is new, stopped or finished."""

from __future__ import annotations

from enum import Enum
from pathlib import Path

from hrl_comfort.config import HIERARCHY
from hrl_comfort.files.provenance import is_finished


class RunState(Enum):
    """State of the training in a folder."""

    NEW = "new"
    STOPPED = "stopped"
    FINISHED = "finished"


def run_state(folder: Path) -> RunState:
    """Return the state of the training or the hierarchy in a folder; raise ConfigError if it is damaged."""
    if is_finished(folder):
        return RunState.FINISHED
    stopped = (folder / HIERARCHY).is_file() or _resumable(folder / "checkpoints")
    return RunState.STOPPED if stopped else RunState.NEW


def _resumable(checkpoints: Path) -> bool:
    if not checkpoints.is_dir():
        return False
    from hrl_comfort.agents.checkpoint import resumable  # seconds, for torch

    return resumable(checkpoints)
