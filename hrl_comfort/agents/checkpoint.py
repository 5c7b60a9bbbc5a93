"""Checkpoint files: careful reads, keeping the newest few."""

import hashlib
import os
import re
import warnings
from pathlib import Path
from typing import Any

import torch

from hrl_comfort.config import ConfigError
from hrl_comfort.files.archives import DAMAGED, check_archive
from hrl_comfort.files.atomic import write_atomically

FORMAT = "hrl-comfort checkpoint"
STEP_FILE = re.compile(r"step_(\d{9})\.pt")
RESUMABLE = ("latest.pt", "previous.pt")
"""Files to resume from, the newest first."""


def save(path: Path, state: dict[str, Any]) -> None:
    """Write a dict of plain tensors, numbers, strings, lists and dicts to `path`."""
    write_atomically(path, lambda file: torch.save({"format": FORMAT, **_own(state)}, file))


def _own(value: Any) -> Any:
    """Return `value` with parts of larger tensors copied: torch would save those whole."""
    if isinstance(value, dict):
        return {key: _own(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_own(each) for each in value]
    if isinstance(value, torch.Tensor) and value.untyped_storage().nbytes() > value.nbytes:
        return value.clone()
    return value


def load(path: Path) -> dict[str, Any]:
    """Read what `save` wrote; nothing but plain data is ever unpickled, and nothing of a damaged file.

    Raises:
        ConfigError: the file is missing, cut short, or not one of ours.
    """
    try:
        check_archive(path)
        state = torch.load(path, map_location="cpu", weights_only=True)
        _check_tensors(state, "its")
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; a checkpoint or policy.pt is needed") from None
    except DAMAGED as error:
        reason = str(error).splitlines()[0][:80] if str(error) else type(error).__name__
        raise ConfigError(f"{path}: cut short or not a checkpoint of this program ({reason})") from None
    if not isinstance(state, dict) or state.get("format") != FORMAT:
        raise ConfigError(f"{path}: not a checkpoint of this program")
    return state


def _check_tensors(value: Any, place: str) -> None:
    """Raise ValueError at a tensor that is not dense, or of which the file holds less than its shape says."""
    if isinstance(value, (dict, list, tuple)):
        for name, each in value.items() if isinstance(value, dict) else enumerate(value):
            _check_tensors(each, f"{place} {name}")
    elif isinstance(value, torch.Tensor):
        plain = not (value.is_quantized or value.is_nested)
        dense = plain and value.layout == torch.strided and value.device.type == "cpu"
        if not dense or value.untyped_storage().nbytes() < value.nbytes:
            raise ValueError(f"{place} is not a dense tensor")


def step_path(folder: Path, policy_steps: int) -> Path:
    """Return the name of the light checkpoint after so many decisions."""
    return folder / f"step_{policy_steps:09d}.pt"


def steps(folder: Path) -> list[Path]:
    """Return the light checkpoints in `folder`, oldest first."""
    return sorted(path for path in folder.glob("step_*.pt") if STEP_FILE.fullmatch(path.name))


def keep_newest(folder: Path, count: int) -> None:
    """Delete all but the newest `count` light checkpoints."""
    for path in steps(folder)[:-count]:
        path.unlink()


def save_resumable(folder: Path, state: dict[str, Any]) -> None:
    """Write `latest.pt`, which alone holds the replay buffer; the one before stays as `previous.pt`."""
    latest, new = folder / "latest.pt", folder / "next.pt"
    save(new, {**state, "digest": _digest(state)})
    if latest.exists():
        os.replace(latest, folder / "previous.pt")
    os.replace(new, latest)


def resumable(folder: Path) -> bool:
    """Return whether there is a checkpoint to resume from, good or not."""
    return any((folder / name).exists() for name in RESUMABLE)


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
