"""Files of plain data and tensors: policies, meta-controllers, checkpoints. Reading them runs no code."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from hrl_comfort.config.checks import ConfigError
from hrl_comfort.files.archives import DAMAGED, check_archive
from hrl_comfort.files.atomic import write_atomically

FORMAT = "hrl-comfort checkpoint"


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
    if path.suffix == ".onnx":
        raise ConfigError(f"{path}: ONNX files are for other programs; give the policy.pt that it was exported from")
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
