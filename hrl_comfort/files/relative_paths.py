"""Paths in the configuration of a run are relative to its folder: it can be read from anywhere, and moved."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from hrl_comfort.config.constants import SCRIPTED_POLICIES, STARTS

KEYS = ("beside", "calibration", "demonstrator", "file", "initial_policy", "next_skill", "policy", "start")
"""Keys of paths, in any section; the values of `policies` are paths too."""
NAMES = (*SCRIPTED_POLICIES, *STARTS)
"""Values of these keys that are no paths; `package.module:callable` and `udp://HOST:PORT` are none either."""
PREFIXES = ("sb3:", "onnx:")
"""Prefixes that may stand before a path."""


def split_prefix(value: str) -> tuple[str, str]:
    """Return the prefix that stands before a path, one of PREFIXES or none, and the path."""
    prefix = next((each for each in PREFIXES if value.startswith(each)), "")
    return prefix, value.removeprefix(prefix)


def stored(values: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return a configuration as the run `folder` holds it: paths relative to the folder, which is its `output`.

    Absolute paths stay as they are, unless they are in the folder's parent, as those of a hierarchy's parts are.
    """
    here = os.path.abspath(folder)
    parent = os.path.dirname(here)

    def change(path: str) -> str:
        given = os.path.abspath(path)
        if os.path.isabs(path) and os.path.commonpath([given, parent]) != parent:
            return path
        relative = os.path.relpath(given, here)
        if _real(os.path.join(here, relative)) == _real(given):
            return relative
        return os.path.relpath(_real(given), _real(here))  # there are links on the way

    return _changed(values, change, ".")


def resolved(values: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return a configuration from the run `folder` with paths that lead there from the working directory.

    Relative paths are relative to the place from which `output` is the run folder: `.` in what `stored` returns, in
    runs of before the working directory of the training.
    """
    output = values.get("output")
    origin = output if isinstance(output, str) else "."

    def change(path: str) -> str:
        if os.path.isabs(path):
            return path
        # `relpath` leaves out a way down into the working directory, where the run folder may not be.
        joined = os.path.join(folder, path if origin == "." else os.path.relpath(path, origin))
        tidy = os.path.normpath(joined)
        return tidy if _real(tidy) == _real(joined) else joined

    return _changed(values, change, str(folder))


def same(values: Mapping[str, Any], others: Mapping[str, Any]) -> bool:
    """Return whether two configurations differ in no more than `output` and the spelling of paths."""
    return _changed(values, _real, "") == _changed(others, _real, "")


def _real(path: str) -> str:
    try:
        return os.path.realpath(path)
    except ValueError:  # a null character
        return path


def _changed(values: Mapping[str, Any], change: Callable[[str], str], output: str) -> dict[str, Any]:
    changed: dict[str, Any] = _walk("", values, change)
    return {**changed, "output": output} if "output" in values else changed


def _walk(key: str, value: Any, change: Callable[[str], str]) -> Any:
    match value:
        case Mapping():
            return {
                name: _walk("policy" if key == "policies" else str(name), each, change) for name, each in value.items()
            }
        case list() | tuple():
            return [_walk("", each, change) for each in value]
        case str() if key.split(".")[-1] in KEYS and value not in NAMES:  # a stage sets dotted keys
            prefix, path = split_prefix(value)
            return value if not path or re.match(r"[\w.]+:", path) else prefix + change(path)
    return value
