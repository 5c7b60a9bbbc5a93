"""Recorded people: CSV and BVH files as poses at each control step."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hrl_comfort.config import CONTROL_STEP_S, ConfigError
from hrl_comfort.config.checks import FARTHEST
from hrl_comfort.files.reading import read_text
from hrl_comfort.humans import body
from hrl_comfort.humans.walk import Array, length

HEADER = ["t", "x", "y", "yaw"]
HANDS = [f"{side}_{axis}" for side in ("left", "right") for axis in "xyz"]
LONGEST_S = 3600.0
SUFFIXES = (".csv", ".bvh")
FORMS = f"a CSV of {','.join(HEADER)} (s, m, m, rad), a BVH file (y up), or a folder of such files"
UNITS_M = {"mm": 0.001, "cm": 0.01, "inches": 0.0254, "units of CMU": 0.0254 / 0.45, "m": 1.0}
"""Units of BVH files, which do not name theirs; the last but one: mocap.cs.cmu.edu/faqs.php."""
ARM_M = (0.4, 0.8)
"""Length of an adult's arm from shoulder to hand, by which the unit of a BVH file is known: one unit at most fits."""
SIDES = {"left": "(left|l)", "right": "(right|r)"}
JOINTS = {
    "shoulder": ("(upper|up)?arm", "(shoulder|shldr)"),
    "elbow": ("(forearm|lowerarm|elbow)",),
    "hand": ("(hand|wrist)",),
}
"""Names of joints, after the side and without other signs, the preferred first: Mixamo's shoulder is a collarbone."""
HIPS = "(mixamorig)?(hips?|pelvis)"
FRAME_S = (1e-4, 1.0)
"""Plausible time between the frames of a BVH file."""
NEAR_M = 10.0
"""A person who never comes so near to the robot is recorded in another unit or frame."""
FASTEST_M_S, SLOWEST_M_S, STROLL_M = 12.0, 0.05, 0.3
"""The record of a sprint; a speed that somebody who moves at all exceeds, and what counts as moving."""
TURN_RAD, TURN_RAD_S = 2 * np.pi, 4.0
"""Jump of a yaw that is a wrap, and the turning that goes on beside it."""
REACH_M, TALLEST_M = 1.5, 3.0
"""Farthest place of a hand: from the person's axis, and above the floor."""


@dataclass(frozen=True)
class Recording:
    """One person at each control step, the first at time 0."""

    position: Array
    """(S, 2) m."""
    yaw: Array
    """(S,) rad, unwrapped."""
    limbs: Array
    """(S, 6, 3) as `Walk.limbs`."""
    placed: bool
    """In the cell frame; otherwise around the origin, on average facing along x."""


@lru_cache(maxsize=8)
def read_recordings(path: str) -> tuple[Recording, ...]:
    """Return the recording of a file, or those of a folder in the order of their paths.

    Raises:
      ConfigError: there is none, or one cannot be read (its line is named).
    """
    place = Path(path)
    found = _recordings_in(place) if place.is_dir() else [place]
    if not found or not all(file.is_file() for file in found):
        raise ConfigError(f"human.file={path!r} does not exist or is empty; it must be {FORMS}")
    return tuple(read_recording(file) for file in found)


def _recordings_in(folder: Path) -> list[Path]:
    """Return the recordings below `folder` in the order of their paths; hidden files and folders are left out."""
    files = (path.relative_to(folder) for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)
    return [folder / path for path in sorted(files) if not any(part.startswith(".") for part in path.parts)]


def read_recording(file: Path) -> Recording:
    """Return the recording of one file; raise ConfigError where it cannot be read."""
    try:
        text = read_text(file)
    except (OSError, ValueError) as error:
        raise ConfigError(f"human.file={str(file)!r} cannot be read: {error}; it must be {FORMS}") from error
    read = _read_bvh if file.suffix.lower() == ".bvh" else _read_csv
    return read(f"human.file={str(file)!r}", text)


def _read_csv(name: str, text: str) -> Recording:
    """Return the recording of a CSV, interpolated linearly.

    Hands are six further columns, left_x to right_z, m: positions in the cell, z above the floor.
    """
    try:
        header, *lines = [*csv.reader(text.splitlines())] or [[]]
    except csv.Error as error:
        raise ConfigError(f"{name} cannot be read: {error}; it must be {FORMS}") from error
    columns = [cell.strip() for cell in header]
    if columns not in (HEADER, HEADER + HANDS):
        raise ConfigError(f"{name}: line 1 must be {','.join(HEADER)}, and perhaps {','.join(HANDS)}")
    if not any(",".join(line).strip() for line in lines):
        raise ConfigError(f"{name} has no line after its header; add one line a pose")
    table = np.array(list(_rows(name, len(columns), lines)))
    time = _control_steps(name, table[-1, 0])
    _check_units(name, np.stack([np.interp(time, table[:, 0], values) for values in table[:, 1:].T]))
    table[:, 3] = np.unwrap(table[:, 3])
    x, y, yaw, *hands = (np.interp(time, table[:, 0], values) for values in table[:, 1:].T)
    position, limbs = np.stack([x, y], axis=-1), np.full((len(time), 6, 3), np.nan)
    if hands:
        there = np.stack(hands, axis=-1).reshape(-1, 2, 3)
        there[..., :2] -= position[:, None]
        limbs = body.reaching(_turned(there, -yaw))
    return Recording(position, yaw, limbs, placed=True)


def _rows(name: str, columns: int, lines: list[list[str]]) -> Iterator[list[float]]:
    before = -np.inf
    for number, line in enumerate(lines, start=2):
        if not ",".join(line).strip():
            continue
        where = f"{name}: line {number}"
        try:
            values = [float(value) for value in line]
        except ValueError:
            values = []
        if len(values) != columns or not np.isfinite(values).all():
            count = "four" if columns == len(HEADER) else "ten"
            raise ConfigError(f"{where} is not {count} finite numbers: {','.join(line)}")
        if not (np.abs(values[1:]) <= FARTHEST).all():
            raise ConfigError(f"{where} has a value beyond ±{FARTHEST:g} (m, rad): {','.join(line)}")
        if values[0] < 0:
            raise ConfigError(f"{where} has t={values[0]:g}; times must be 0 or more: subtract the first time from all")
        if values[0] <= before:
            raise ConfigError(f"{where} has t={values[0]:g}, not after {before:g}")
        before = values[0]
        yield values


def _check_units(name: str, columns: Array) -> None:
    """Raise ConfigError where x, y, yaw and perhaps hands, (C, S) by control step, are nobody's in m, rad and s."""
    place, yaw, hands = columns[:2], columns[2], columns[3:].reshape(2, 3, -1) if len(columns) > 3 else None
    nearest, fastest, extent = length(place.T).min(), _change(place, 1.0), np.ptp(place, axis=1).max()
    if nearest > NEAR_M:
        raise ConfigError(f"{name}: columns x, y never come within {NEAR_M:g} of the robot; they must be in m")
    if fastest > FASTEST_M_S:
        raise ConfigError(f"{name}: columns x, y change by {fastest:.4g} within a second; they must be in m")
    if extent > STROLL_M and fastest < SLOWEST_M_S:
        raise ConfigError(f"{name}: column t lets the person move at {fastest:.1g} m/s at most; it must be in s")
    turned = any(_change(yaw[None], window) > TURN_RAD + TURN_RAD_S * window for window in (1.0, 10.0))
    if turned or abs(yaw[0]) > TURN_RAD:
        raise ConfigError(f"{name}: column yaw begins beyond ±2π or spins; it must be in rad")
    if hands is not None:
        away = np.median(np.hypot(*(hands[:, :2] - place).swapaxes(0, 1)), axis=-1).max()
        if away > REACH_M or not (np.abs(np.median(hands[:, 2], axis=-1)) < TALLEST_M).all():
            raise ConfigError(
                f"{name}: columns {HANDS[0]} … {HANDS[-1]} are out of the person's reach; they must be in m"
            )


def _change(values: Array, window_s: float) -> float:
    """Return the largest change of values (C, S), one a control step, within `window_s` or the whole recording."""
    steps = min(round(window_s / CONTROL_STEP_S), values.shape[1] - 1)
    return float(np.linalg.norm(values[:, steps:] - values[:, : values.shape[1] - steps], axis=0).max())


def _control_steps(name: str, duration_s: float) -> Array:
    if duration_s > LONGEST_S:
        raise ConfigError(f"{name} lasts {duration_s:g} s; at most {LONGEST_S:g} s are read")
    steps = max(int(np.ceil(duration_s / CONTROL_STEP_S)), 0)
    return np.asarray(np.arange(steps + 1) * CONTROL_STEP_S, dtype=np.float64)


def _read_bvh(name: str, text: str) -> Recording:
    """Return the recording of a BVH file, y up, as `Recording.placed` = False says.

    The hips are the person's place, the shoulders their heading. The arms keep their directions; their lengths are
    those of the human in the scene, whose trunk is upright: markers on the back would make it lean backwards.
    """
    try:
        head, *motion = re.split(r"^\s*MOTION\s*$", text, maxsplit=1, flags=re.MULTILINE)
        found = re.match(r"\s*Frames:\s*(\d+)\s+Frame Time:\s*([\d.eE+-]+)\s", motion[0] if motion else "")
        if found is None:
            raise ValueError("after MOTION come lines such as Frames: 100 and Frame Time: 0.01")
        count, seconds = int(found[1]), float(found[2])
        numbers = np.array(motion[0][found.end() :].split(), dtype=np.float64)
        if not FRAME_S[0] <= seconds <= FRAME_S[1]:
            raise ValueError(f"Frame Time: {seconds:g} is not from {FRAME_S[0]:g} to {FRAME_S[1]:g} s")
        if not numbers.size or not count or numbers.size % count or not np.isfinite(numbers).all():
            raise ValueError(f"after Frame Time come {numbers.size} numbers, not {count} frames of finite ones")
        numbers = numbers.reshape(count, -1)
        joints = _joint_positions(head, numbers)
        hip = _one_joint(joints, "hips or pelvis", HIPS)
        arms = [
            [_one_joint(joints, f"the {side} {part}", *(f"(mixamorig)?{SIDES[side]}{each}" for each in names))
             for side in SIDES]
            for part, names in JOINTS.items()
        ]  # fmt: skip
        scale = _unit_m(arms)
        if not all(np.isfinite(each).all() for each in (hip, *chain(*arms))):
            raise ValueError("its joints are infinitely far away")
        if np.median(arms[0][0][:, 2] - hip[:, 2]) <= 0.0:
            raise ValueError("its shoulders are not above its hips; export it with y up")
    except (ValueError, IndexError) as error:
        raise ConfigError(f"{name} is not a BVH file of a whole person: {error}") from error
    hip, (shoulder, elbow, hand) = hip * scale, arms
    across = shoulder[0] - shoulder[1]
    yaw = np.unwrap(np.arctan2(-across[:, 0], across[:, 1]))
    segments = np.stack([b - a for a, b in zip(shoulder + elbow, elbow + hand, strict=True)], axis=1)
    facing = float(np.arctan2(np.sin(yaw).mean(), np.cos(yaw).mean()))
    limbs = _turned(segments / np.linalg.norm(segments, axis=-1, keepdims=True), -yaw)
    flat = np.column_stack([hip[:, :2] - np.median(hip[:, :2], axis=0), np.zeros(len(hip))])[:, None]
    position = _turned(flat, np.full(len(hip), -facing))[:, 0, :2]
    recorded = np.arange(len(numbers)) * seconds
    time = _control_steps(name, recorded[-1])
    columns = np.column_stack([position, yaw - facing, limbs.reshape(len(limbs), -1)]).T
    resampled = np.stack([np.interp(time, recorded, column) for column in columns], axis=-1)
    segments = resampled[:, 3:].reshape(-1, 4, 3)
    limbs = np.full((len(time), 6, 3), np.nan)
    limbs[:, 2:] = segments / np.linalg.norm(segments, axis=-1, keepdims=True)
    return Recording(resampled[:, :2], resampled[:, 2], limbs, placed=False)


def _unit_m(arms: list[list[Array]]) -> float:
    """Return the unit of length, m, in which shoulders, elbows and hands (T, 3) are those of an adult.

    Raises:
      ValueError: there is none.
    """
    shoulder, elbow, hand = arms
    lengths = [np.linalg.norm(b - a, axis=-1) for a, b in zip(shoulder + elbow, elbow + hand, strict=True)]
    if not all(each.all() for each in lengths):
        raise ValueError("shoulder, elbow or hand are in the same place")
    arm = sum(float(np.median(each)) for each in lengths) / 2
    unit = next((unit for unit in UNITS_M.values() if ARM_M[0] <= arm * unit <= ARM_M[1]), None)
    if unit is None:
        raise ValueError(f"its arms are {arm:.3g} long, which is an adult's length in none of {', '.join(UNITS_M)}")
    return unit


def _joint_positions(head: str, numbers: Array) -> dict[str, Array]:
    """Return the position (T, 3) of each joint, z up, of the hierarchy in `head`; numbers (T, channels)."""
    frames: list[tuple[Rotation, Array]] = []
    joints: dict[str, Array] = {}
    name, column = "", 0
    offset = np.zeros(3)
    for line in head.splitlines():
        word, *rest = line.split() or [""]
        if word in ("ROOT", "JOINT", "End"):
            name = re.sub("[^a-z]", "", " ".join(rest).split(":")[-1].lower())
        elif word == "OFFSET":
            offset = np.array(rest, dtype=np.float64)
            if name == "site":  # an end has no channels
                frames.append(frames[-1])
        elif word == "CHANNELS":
            channels = [channel.lower() for channel in rest[1:]]
            mine = numbers[:, column : column + len(channels)]
            column += len(channels)
            if mine.shape[1] != len(channels):
                raise ValueError("its frames have too few numbers")
            shift = offset + np.zeros((len(numbers), 3))
            turns = [index for index, channel in enumerate(channels) if channel.endswith("rotation")]
            for index, channel in enumerate(channels):
                if channel.endswith("position"):
                    shift[:, "xyz".index(channel[0])] += mine[:, index]
            local = Rotation.identity()
            if turns:
                order = "".join(channels[index][0] for index in turns).upper()
                local = Rotation.from_euler(order, mine[:, turns], degrees=True)
            turn, origin = frames[-1] if frames else (Rotation.identity(), np.zeros((len(numbers), 3)))
            origin = origin + turn.apply(shift)
            frames.append((turn * local, origin))
            joints[name] = np.stack([origin[:, 0], -origin[:, 2], origin[:, 1]], axis=-1)
        elif word == "}":
            frames.pop()
    return joints


def _one_joint(joints: dict[str, Array], what: str, *patterns: str) -> Array:
    """Return the position (T, 3) of the first joint of the first of `patterns` that there is."""
    found = [name for pattern in patterns for name in joints if re.fullmatch(pattern, name)]
    if not found:
        raise ValueError(f"it has no joint for {what}, only {', '.join(joints)}")
    return joints[found[0]]


def _turned(vectors: Array, yaw: Array) -> Array:
    """Return vectors (n, m, 3) turned by yaw (n,) rad about z."""
    cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)


def bounds(recordings: tuple[Recording, ...]) -> tuple[float, float]:
    """Return the largest speed (m/s) and acceleration (m/s²) of the person's axis in the recordings."""
    steps = [np.diff(each.position, axis=0) / CONTROL_STEP_S for each in recordings]
    fastest = max((length(step).max(initial=0.0) for step in steps), default=0.0)
    changes = [length(np.diff(step, axis=0)).max(initial=0.0) / CONTROL_STEP_S for step in steps]
    return float(fastest), float(max(changes))
