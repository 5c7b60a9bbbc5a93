"""A recorded motion: CSV of t, x, y, yaw in s, m, m, rad, cell frame."""

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
    """Follow the file, linearly interpolated and held at its end. Spawn, bound and keep-out do not apply."""
    assert config.file is not None
    time, poses = read_motion(config.file)
    now = (walk.step + 1) * CONTROL_STEP_S
    x, y, yaw = (np.interp(now, time, column) for column in poses.T)
    return np.stack([x, y], axis=-1), yaw


@lru_cache(maxsize=32)
def read_motion(path: str) -> tuple[Array, Array]:
    """Return times (T,) s and poses (T, 3) m, m, rad (yaw unwrapped) of a motion file.

    Raises:
      ConfigError: no such file, another header, or a bad line (named).
    """
    if not Path(path).is_file():
        raise ConfigError(f"human.file={path!r} does not exist; it must be a CSV of t,x,y,yaw")
    try:
        lines = list(csv.reader(Path(path).read_text(encoding="utf-8-sig").splitlines()))
    except UnicodeDecodeError:
        raise ConfigError(f"human.file={path!r} is not text; it must be a CSV of t,x,y,yaw") from None
    if not lines or [name.strip() for name in lines[0]] != HEADER:
        raise ConfigError(f"human.file={path!r}: line 1 must be {','.join(HEADER)}")
    rows: list[list[float]] = []
    for number, line in enumerate(lines[1:], start=2):
        try:
            values = [float(value) for value in line]
        except ValueError as error:
            raise ConfigError(f"human.file={path!r}: line {number} is not four numbers: {','.join(line)}") from error
        if len(values) != 4 or not np.isfinite(values).all():
            raise ConfigError(f"human.file={path!r}: line {number} is not four finite numbers: {','.join(line)}")
        if not (np.abs(values[1:]) <= FARTHEST).all():
            raise ConfigError(
                f"human.file={path!r}: line {number} has x, y or yaw beyond ±{FARTHEST:g}: {','.join(line)}"
            )
        if rows and values[0] <= rows[-1][0]:
            raise ConfigError(f"human.file={path!r}: line {number} has t={values[0]:g}, not after {rows[-1][0]:g}")
        rows.append(values)
    if not rows:
        raise ConfigError(f"human.file={path!r} holds no line after its header")
    table = np.array(rows)
    return table[:, 0], np.column_stack([table[:, 1:3], np.unwrap(table[:, 3])])
