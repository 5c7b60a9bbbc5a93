"""Checkpoint files of a run: those to resume from, and the newest few policies."""

import hashlib
import os
import warnings
from pathlib import Path
from typing import Any

import torch

from hrl_comfort.config import ConfigError
from hrl_comfort.files.provenance import RESUMABLE, step_files
from hrl_comfort.files.state_file import load, save


def keep_newest(folder: Path, count: int) -> None:
    """Delete all but the newest `count` light checkpoints."""
    for path in step_files(folder)[:-count]:
        path.unlink()


def save_resumable(folder: Path, state: dict[str, Any]) -> None:
    """Write `latest.pt`, which alone holds the replay buffer; the one before stays as `previous.pt`."""
    latest, new = folder / "latest.pt", folder / "next.pt"
    save(new, {**state, "digest": _digest(state)})
    if latest.exists():
        os.replace(latest, folder / "previous.pt")
    os.replace(new, latest)


def load_resumable(folder: Path) -> dict[str, Any]:
    """Read the newest good resumable checkpoint; a broken one is named in a warning and passed over.

    Raises:
        ConfigError: there is none.
    """
    for path in (folder / name for name in RESUMABLE if (folder / name).exists()):
        try:
            state = load(path)
            digest = state.pop("digest", None)
            if digest != _digest({name: each for name, each in state.items() if name != "format"}):
                raise ConfigError(f"{path}: its content was changed")
            return state
        except ConfigError as error:
            warnings.warn(f"skipped {error}", stacklevel=2)
    raise ConfigError(f"{folder}: no checkpoint to resume from ({', '.join(RESUMABLE)})")


def _digest(state: dict[str, Any]) -> str:
    """Return the hash of all but the numbers in tensors, of which the archive has checksums."""

    def skeleton(value: Any) -> Any:
        if isinstance(value, torch.Tensor):
            return str(value.dtype), tuple(value.shape)
        if isinstance(value, dict):
            return {key: skeleton(each) for key, each in value.items()}
        return [skeleton(each) for each in value] if isinstance(value, (list, tuple)) else value

    return hashlib.sha256(repr(skeleton(state)).encode()).hexdigest()


def drop_resumable(folder: Path) -> None:
    """Delete the large resumable checkpoints: the training is finished."""
    for name in (*RESUMABLE, "next.pt"):
        (folder / name).unlink(missing_ok=True)
