"""ZIP archives, which .npz and .pt files are: their sizes are known before anything is unpacked."""

from __future__ import annotations

import lzma
import pickle
import struct
import tokenize
import zlib
from pathlib import Path
from zipfile import BadZipFile, ZipFile

DAMAGED = (
    ValueError, LookupError, RuntimeError, OSError, EOFError, MemoryError, OverflowError, TypeError, AttributeError,
    SyntaxError, struct.error, zlib.error, lzma.LZMAError, tokenize.TokenError, BadZipFile, pickle.UnpicklingError,
)  # fmt: skip
"""Errors of zipfile, numpy and torch at a damaged file."""


def check_archive(path: Path, most_bytes: int | None = None) -> None:
    """Raise an error of DAMAGED unless `path` is a regular file, and an archive with correct checksums.

    Its content may be of `most_bytes`, by default those of the file, as of an archive without compression.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path} is no regular file")
    with ZipFile(path) as archive:
        content = sum(member.file_size for member in archive.infolist())
        if content > (path.stat().st_size if most_bytes is None else most_bytes):
            raise BadZipFile(f"it unpacks to {content / 1e6:.0f} MB")
        damaged = archive.testzip()
    if damaged is not None:
        raise BadZipFile(f"{damaged} is not what its checksum says")
