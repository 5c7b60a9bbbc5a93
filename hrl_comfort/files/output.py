"""Places to write to: new files, and folders that this program made or found empty; one process at a time."""

from __future__ import annotations

import errno
import fcntl
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hrl_comfort.config import ConfigError
from hrl_comfort.files.atomic import TEMPORARY, overwrites, target_of
from hrl_comfort.files.run_config import load_config
from hrl_comfort.files.sweep_record import FILE, read_job

SIGNATURE = b"hrl-comfort"
"""In the first kilobyte of every page and picture that this program writes."""
EVALUATION_MARKS = ("config.yaml", "checkpoints/config.yaml", "handover.yaml")
"""Configurations by which the folder of an evaluation is known."""
INSIST = "choose another output, or add --overwrite"


@contextmanager
def held_folder(folder: Path) -> Iterator[None]:
    """Make `folder` and hold it for one process as long as the context lasts; one that stays empty is removed.

    Raises:
      ConfigError: it cannot be written, or another process writes in it.
    """
    with _made(folder):
        try:
            if not os.access(folder, os.W_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        except OSError as error:
            raise _unwritable(folder, error) from error
        try:
            _lock(descriptor, folder)
            yield
        finally:
            os.close(descriptor)


def in_use(folder: Path) -> bool:
    """Return whether another process holds a folder."""
    try:
        with held_folder(folder):
            return False
    except ConfigError:
        return True


@contextmanager
def output_folder(folder: Path, kind: type, *marks: str) -> Iterator[None]:
    """Hold `folder`, which must be the program's: new, empty, or with a configuration of `kind` in a file of `marks`.

    The folder of a sweep's job may also hold the job's record.

    Raises:
      ConfigError: it cannot be written, another process writes in it, or it is not the program's.
    """
    with held_folder(folder):
        if not (overwrites() or is_own(folder, kind, *marks)):
            raise ConfigError(f"output={str(folder)!r} holds other files than those of this command; {INSIST}")
        yield


def is_own(folder: Path, kind: type, *marks: str) -> bool:
    """Return whether a folder is the program's; see `output_folder`."""
    names = {each.name for each in folder.iterdir() if not TEMPORARY.fullmatch(each.name)} if folder.exists() else set()
    try:
        if FILE in names:
            read_job(folder)
        if names <= {FILE}:
            return True
        return any(isinstance(load_config(folder / mark), kind) for mark in marks if (folder / mark).is_file())
    except ConfigError:
        return False


@contextmanager
def output_file(path: Path, *suffixes: str) -> Iterator[None]:
    """Hold a file, and those of the same name with other `suffixes`, for one process as long as the context lasts.

    A page or picture may replace an earlier one of this program; of other files there must be none.

    Raises:
      ConfigError: `path` is no regular file, another process writes it, or it is there and not the program's.
    """
    if not path.name:
        raise ConfigError(f"output={str(path)!r} is a folder; give the name of a file")
    with _made(path.parent):
        lock = path.with_name(f".{path.name}.lock")
        try:
            found = [each for each in map(target_of, (path, *map(path.with_suffix, suffixes))) if each.exists()]
            own = path.is_file() and SIGNATURE in _beginning(path)
            descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        except OSError as error:
            raise _unwritable(path, error) from error
        try:
            _lock(descriptor, path)
            try:
                if found and not own and not overwrites():
                    raise ConfigError(f"output={str(found[0])!r} is there already, and not of this command; {INSIST}")
                yield
            finally:
                lock.unlink(missing_ok=True)
        finally:
            os.close(descriptor)


def _beginning(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(1024)


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """Make `folder` and its parents; those that are empty at the end are removed."""
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unwritable(folder, error) from error
    try:
        yield
    finally:
        for path in made:
            with suppress(OSError):
                path.rmdir()


def _unwritable(path: Path, error: OSError) -> ConfigError:
    there = next(each for each in (path, *path.parents) if each.exists())
    what = error.strerror if there.is_dir() or error.errno not in (errno.EEXIST, errno.ENOTDIR) else "Not a directory"
    return ConfigError(f"output={str(path)!r} cannot be written: {there}: {what or error}")


def _lock(descriptor: int, path: Path) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise ConfigError(f"{path} is in use by another process; choose another output") from None
    except OSError as error:
        said = f"{path}: its file system has no locks ({error.strerror}); let no other process write there"
        warnings.warn(said, stacklevel=3)
