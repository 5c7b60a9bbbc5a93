"""Files that are read whole: regular, and of a size that memory holds."""

from __future__ import annotations

from pathlib import Path

MOST_BYTES = 5 * 10**8
"""Largest table or recording."""


def read_bytes(path: Path, most_bytes: int = MOST_BYTES) -> bytes:
    """Return the content of a file.

    Raises:
      OSError: it cannot be read.
      ValueError: it is larger than `most_bytes`, or no regular file; the error does not name it.
    """
    if path.exists() and not path.is_file():
        raise ValueError("it is not a regular file")
    if (size := path.stat().st_size) > most_bytes:
        raise ValueError(f"it is of {size / 1e6:.4g} MB; at most {most_bytes / 1e6:g} MB are read")
    return path.read_bytes()


def read_text(path: Path, most_bytes: int = MOST_BYTES) -> str:
    """Return the UTF-8 text of a file, without a byte order mark and with other ends of lines as in Python.

    Raises:
      OSError: it cannot be read.
      ValueError: as `read_bytes`, or it is not text in UTF-8; the error names the line.
    """
    data = read_bytes(path, most_bytes)
    if (zero := data.find(b"\0")) >= 0:  # a file of holes would be decoded to several times its size
        line = data.count(b"\n", 0, zero) + 1
        raise ValueError(f"line {line}: byte 0x00 is not text")
    try:
        return data.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ValueError(f"line {line}: byte {data[error.start]:#04x} is not UTF-8") from None
