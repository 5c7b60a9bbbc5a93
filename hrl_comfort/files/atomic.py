"""Atomic writing: a file is either whole or not there."""

from __future__ import annotations

import json
import os
import re
import secrets
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any, BinaryIO

STALE_S = 3600
"""Age at which the temporary file of a killed process is deleted."""
TEMPORARY = re.compile(r"\..*\.[0-9a-f]{8}\.tmp", re.DOTALL)
"""Name of a temporary file."""
OVERWRITE = "HRL_COMFORT_OVERWRITE"
"""Environment variable by which `--overwrite` reaches the jobs of a sweep."""
_held_back: ContextVar[list[tuple[Path, Path]] | None] = ContextVar("held_back", default=None)
"""Temporary files and their targets, inside `all_or_none`."""


def overwrites() -> bool:
    """Return whether the user insists on replacing files that this program did not write."""
    return OVERWRITE in os.environ


def target_of(path: Path) -> Path:
    """Return the file that writing `path` replaces, or makes: symbolic links are followed.

    Raises:
      OSError: it is a device, a FIFO, a folder, or an existing file to which `path` is only a link.
    """
    real = Path(os.path.realpath(path))
    if real.is_symlink() or (real.exists() and not real.is_file()):  # the former where links lead in a circle
        raise OSError(f"{path} is not a regular file; choose another output")
    if path.is_symlink() and real.exists() and not overwrites():
        raise OSError(f"{path} is a link to {real}, which is there already; choose another output, or add --overwrite")
    return real


def write_atomically(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Let `write` fill a temporary file beside `path`, then move it to `path` in one step.

    Raises:
      OSError: `path` is no regular file, or could not be written, for example on a full disk; what was there stays.
    """
    path = target_of(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    for stale in path.parent.iterdir():
        with suppress(FileNotFoundError):  # another process may delete it too
            mine = stale.name.startswith(f".{path.name}.") and TEMPORARY.fullmatch(stale.name)
            if mine and time.time() - stale.lstat().st_mtime > STALE_S:
                stale.unlink()
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    held_back = _held_back.get()
    try:
        with temporary.open("xb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        if held_back is None:
            os.replace(temporary, path)
        else:
            held_back.append((temporary, path))
    except RuntimeError as error:  # torch.save raises it on a full disk
        raise OSError(f"{path} could not be written: {str(error).splitlines()[0]}") from error
    finally:
        if held_back is None or (temporary, path) not in held_back:
            temporary.unlink(missing_ok=True)


@contextmanager
def all_or_none(*stale: Path) -> Iterator[None]:
    """Hold back the files written in this context until its end, and write none of them if one fails.

    They replace what was there in the order of writing, after the files `stale` and the last one have been deleted:
    where the last one is there, all are, even if the process was killed.
    """
    held_back: list[tuple[Path, Path]] = []
    token = _held_back.set(held_back)
    try:
        yield
        for path in (*stale, *(path for _, path in held_back[-1:])):
            path.unlink(missing_ok=True)
        for temporary, path in held_back:
            os.replace(temporary, path)
    finally:
        _held_back.reset(token)
        for temporary, _ in held_back:
            temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text to `path` in one step."""
    write_atomically(path, lambda file: file.write(text.encode()))


def write_json(path: Path, content: Any) -> None:
    """Write JSON to `path` in one step; raise ValueError at a number that is not finite."""
    write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")
