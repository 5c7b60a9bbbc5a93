"""Starts of subtasks: at home, or with the tool at the object or where the object belongs.

A start of an arm of J joints is 3 J numbers: joint angles, rad, velocities, rad/s, and servo targets, rad. Starts
by inverse kinematics are at rest; recorded ones keep the motion of the arm that a chained policy takes over. These may
have numbers more: with a gripper the positions and velocities of all bodies (nq + nv), the set-point of the fingers
and, where `randomise.object_size` draws them, the sizes of objects of each kind; then what the terminal states of a
policy depend on, the human's x, y (m) and the level, NaN without one, and in a cell that varies the number of the
layout.
"""

from __future__ import annotations

import math
import zlib
from pathlib import Path
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import STARTS, ConfigError, EnvConfig
from hrl_comfort.files.archives import DAMAGED, check_archive
from hrl_comfort.tasks import Start

Array = NDArray[np.float64]

PARTS, WITH_HUMAN, WITH_LAYOUT = 3, 3, 1
"""Numbers of a start: for each joint, for the human and the level, and for the layout."""
MOST_BYTES = 10**8
"""Largest size of the arrays of a file, unpacked."""
ROUNDED = 1e-6
"""Error of a recorded factor of size."""
MOST = 100.0
"""Largest angle, rad, velocity, rad/s, and coordinate, m, of a valid start."""


def recorded_starts(config: EnvConfig, start: Start, joints: int, hand: int = 0) -> list[Array] | None:
    """Return the starts of a file for each kind of object, None where starts are made, not read.

    Otherwise `task.start` is an .npz with an array named as each kind of `cell.objects`, as `evaluate terminal_states=`
    records them: (M, 3 J + H), (M, 3 J + H + 3) or, in a cell that varies, (M, 3 J + H + 4), H the numbers of a `hand`.

    Raises:
      ConfigError: the file is missing, damaged, of another kind of cell or of more levels than `comfort.levels`.
    """
    if start == Start.HOME or config.task.start in STARTS:
        return None
    layouts = config.cell.vary.layouts
    own, kinds = fingerprint(config) if layouts or hand else None, config.cell.kinds
    banks = recorded(config.task.start, config.comfort.levels, joints, kinds, hand, layouts, own)
    low, high = config.randomise.object_size
    for kind, bank in zip(kinds, banks if config.randomise.resized else [], strict=False):
        sizes = bank[:, PARTS * joints + hand - len(kinds) : PARTS * joints + hand]
        if not ((sizes > low - ROUNDED) & (sizes < high + ROUNDED)).all():
            raise ConfigError(
                f"task.start={config.task.start!r}: {kind!r} has objects whose sizes are not in "
                f"randomise.object_size=[{low:g}, {high:g}]; record it anew with this range"
            )
    return banks


def fingerprint(config: EnvConfig) -> int:
    """Return a number of the cell and the robot, by which recorded starts know their layouts and bodies."""
    return zlib.crc32(repr((config.cell, config.robot)).encode())


def _bank(archive: ZipFile, name: str) -> Array:
    """Return an array of an .npz; raise ValueError if the file holds less than its header says."""
    with archive.open(name) as file:
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(file)
    if math.prod(shape) * dtype.itemsize > archive.getinfo(name).file_size:
        raise ValueError(f"{name} is cut short")
    with archive.open(name) as file:
        return np.asarray(np.lib.format.read_array(file), dtype=np.float64)


def at_rest(joint_pos: Array) -> Array:
    """Return the starts (M, 3 J) of joint angles (M, J) at rest, the servo targets at the joint angles."""
    return np.concatenate([joint_pos, np.zeros_like(joint_pos), joint_pos], axis=1)


def recorded(
    path: str,
    levels: int,
    joints: int,
    kinds: tuple[str, ...],
    hand: int = 0,
    layouts: int = 0,
    cell: int | None = None,
) -> list[Array]:
    """Return the recorded starts (M, 3 J or more) of each of `kinds`; their levels are 1 to `levels`.

    `hand` is the numbers of a hand, `layouts` the number of layouts of a cell that varies, and `cell` the fingerprint
    that the file must have, None: any.
    """
    own = PARTS * joints + hand
    whole = own + WITH_HUMAN
    widths = (whole + WITH_LAYOUT,) if layouts else (own, whole)
    shapes = " or ".join(f"(M, {width})" for width in widths)
    if not Path(path).is_file():
        raise ConfigError(f"task.start={path!r} is neither 'ik' nor an existing .npz file")
    try:
        check_archive(Path(path), MOST_BYTES)
        with ZipFile(path) as archive:
            banks = [_bank(archive, f"{kind}.npy") for kind in kinds]
            there = None if cell is None else int(_bank(archive, "cell.npy"))
    except DAMAGED as error:
        raise ConfigError(
            f"task.start={path!r} must hold an array of shape {shapes} for each of {', '.join(kinds)}"
        ) from error
    if there != cell:
        raise ConfigError(f"task.start={path!r} was recorded in another cell or of another robot; record it anew")
    for kind, bank in zip(kinds, banks, strict=True):
        shaped = bank.ndim == 2 and bank.shape[1] in widths and len(bank)
        people = bank[:, own : whole - 1] if shaped else bank
        if layouts:  # nobody is NaN
            people = people[~np.isnan(people).all(axis=1)]
        bounded = shaped and all((np.abs(part) < MOST).all() for part in (bank[:, : PARTS * joints], people))
        if not bounded or not np.isfinite(bank[:, :own]).all():
            raise ConfigError(
                f"task.start={path!r}: {kind!r} has shape {bank.shape}; "
                f"it must be {shapes}, finite, every value within ±{MOST:g}"
            )
        level, layout = bank[:, whole - 1 : whole], bank[:, whole:]
        if not (np.isnan(level) | ((level >= 1) & (level <= levels))).all():
            raise ConfigError(f"task.start={path!r}: {kind!r} has levels that are not in 1 to {levels}")
        if not np.isin(layout, np.arange(layouts)).all():
            raise ConfigError(f"task.start={path!r}: {kind!r} has layouts that are not in 0 to {layouts - 1}")
    return banks


def unseen_left_out(bank: Array, own: int, config: EnvConfig, spawns: Array) -> Array:
    """Return the starts (M, `own` or more) whose human, if any, is clear of each held-out one of `spawns` (s, 2) m.

    Raises:
      ConfigError: there is none.
    """
    if bank.shape[1] == own:
        return bank
    human = config.human
    apart = bank[:, None, own : own + 2] - spawns[list(human.held_out)]
    clear = ~(np.linalg.norm(apart, axis=-1) < human.spawn_margin_m).any(axis=1)
    if not clear.any():
        raise ConfigError(
            f"task.start={config.task.start!r}: in each of its starts the human is within "
            f"human.spawn_margin_m={human.spawn_margin_m} of a held-out spawn point"
        )
    return bank[clear]
