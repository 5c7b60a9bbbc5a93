"""Motion `playback`: a recorded CSV of t, x, y, yaw in s, m, m, rad, cell frame."""

from __future__ import annotations

import csv
from functools import lru_cache
from pathlib import Path

import numpy as np

from hrl_comfort.config import CONTROL_STEP_S, ConfigError, HumanConfig
from hrl_comfort.config.checks import FARTHEST
from hrl_comfort.humans.walk import Array, Walk

HEADER = ["t", "x", "y", "yaw"]


def playback(config: HumanConfig, walk: Walk, noise: Array, tcp: Array) -> tuple[Array, Array]:
    """Follow `file`, interpolated linearly and held at its end; spawn, bound and keep-out do not apply."""
    assert config.file is not None
    time, poses = read_motion(config.file)
    now = (walk.step + 1) * CONTROL_STEP_S
    x, y, yaw = (np.interp(now, time, column) for column in poses.T)
    return np.stack([x, y], axis=-1), yaw


@lru_cache(maxsize=32)
def read_motion(path: str) -> tuple[Array, Array]:
    """Return times (T,) s and poses (T, 3) m, m, rad (yaw unwrapped) of a motion file.

    Raises:
      ConfigError: no such file, not text, a wrong header, or a bad line (named).
    """
    name = f"human.file={path!r}"
    if not Path(path).is_file():
        raise ConfigError(f"{name} does not exist; it must be a CSV of {','.join(HEADER)}")
    try:
        header, *lines = [*csv.reader(Path(path).read_text(encoding="utf-8-sig").splitlines())] or [[]]
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{name} cannot be read: {error}; it must be a CSV of {','.join(HEADER)}") from error
    if [cell.strip() for cell in header] != HEADER:
        raise ConfigError(f"{name}: line 1 must be {','.join(HEADER)}")
    if not lines:
        raise ConfigError(f"{name} has no line after its header; add one line a pose")
    rows: list[list[float]] = []
    for number, line in enumerate(lines, start=2):
        where = f"{name}: line {number}"
        try:
            values = [float(value) for value in line]
        except ValueError:
            values = []
        if len(values) != 4 or not np.isfinite(values).all():
            raise ConfigError(f"{where} is not four finite numbers: {','.join(line)}")
        if not (np.abs(values[1:]) <= FARTHEST).all():
            raise ConfigError(f"{where} has x, y or yaw beyond ±{FARTHEST:g}: {','.join(line)}")
        if rows and values[0] <= rows[-1][0]:
            raise ConfigError(f"{where} has t={values[0]:g}, not after {rows[-1][0]:g}")
        rows.append(values)
    table = np.array(rows)
    return table[:, 0], np.column_stack([table[:, 1:3], np.unwrap(table[:, 3])])
