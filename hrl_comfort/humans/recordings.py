"""Recorded people: CSV and BVH files as poses at each control step."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hrl_comfort.config import CONTROL_STEP_S, ConfigError
from hrl_comfort.config.checks import FARTHEST
from hrl_comfort.humans import body
from hrl_comfort.humans.walk import Array, length

HEADER = ["t", "x", "y", "yaw"]
HANDS = [f"{side}_{axis}" for side in ("left", "right") for axis in "xyz"]
LONGEST_S = 3600.0
FORMS = f"a CSV of {','.join(HEADER)} (s, m, m, rad), a BVH file (mm, y up), or a folder of such files"
JOINTS = {"shoulder": "(upper)?arm", "elbow": "(forearm|lowerarm|elbow)", "hand": "(hand|wrist)"}
"""Names of joints, after the side and without other signs, as in recordings of Vicon, CMU and Mixamo."""


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
    found = sorted(file for file in place.rglob("*") if file.suffix in (".csv", ".bvh")) if place.is_dir() else [place]
    if not found or not all(file.is_file() for file in found):
        raise ConfigError(f"human.file={path!r} does not exist or is empty; it must be {FORMS}")
    return tuple(read_recording(file) for file in found)


def read_recording(file: Path) -> Recording:
    """Return the recording of one file; raise ConfigError where it cannot be read."""
    try:
        text = file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(f"human.file={str(file)!r} cannot be read: {error}; it must be {FORMS}") from error
    return _read_bvh(f"human.file={str(file)!r}", text) if file.suffix == ".bvh" else _read_csv(str(file), text)


def _read_csv(path: str, text: str) -> Recording:
    """Return the recording of a CSV, interpolated linearly.

    Hands are six further columns, left_x to right_z, m: positions in the cell, z above the floor.
    """
    name = f"human.file={path!r}"
    try:
        header, *lines = [*csv.reader(text.splitlines())] or [[]]
    except csv.Error as error:
        raise ConfigError(f"{name} cannot be read: {error}; it must be {FORMS}") from error
    columns = [cell.strip() for cell in header]
    if columns not in (HEADER, HEADER + HANDS):
        raise ConfigError(f"{name}: line 1 must be {','.join(HEADER)}, and perhaps {','.join(HANDS)}")
    if not lines:
        raise ConfigError(f"{name} has no line after its header; add one line a pose")
    table = np.array(list(_rows(name, len(columns), lines)))
    time = _control_steps(name, table[-1, 0])
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
        where = f"{name}: line {number}"
        try:
            values = [float(value) for value in line]
        except ValueError:
            values = []
        if len(values) != columns or not np.isfinite(values).all():
            count = "four" if columns == len(HEADER) else "ten"
            raise ConfigError(f"{where} is not {count} finite numbers: {','.join(line)}")
        if not (np.abs(values[1:]) <= FARTHEST).all():
            raise ConfigError(f"{where} has x, y or yaw beyond ±{FARTHEST:g}: {','.join(line)}")
        if values[0] <= before:
            raise ConfigError(f"{where} has t={values[0]:g}, not after {before:g}")
        before = values[0]
        yield values


def _control_steps(name: str, duration_s: float) -> Array:
    if duration_s > LONGEST_S:
        raise ConfigError(f"{name} lasts {duration_s:g} s; at most {LONGEST_S:g} s are read")
    steps = max(int(np.ceil(duration_s / CONTROL_STEP_S)), 0)
    return np.asarray(np.arange(steps + 1) * CONTROL_STEP_S, dtype=np.float64)


def _read_bvh(name: str, text: str) -> Recording:
    """Return the recording of a BVH file in mm, y up, as `Recording.placed` = False says.

    The hips are the person's place, the shoulders their heading. The arms keep their directions; their lengths are
    those of the human in the scene, whose trunk is upright: markers on the back would make it lean backwards.
    """
    try:
        head, motion = re.split(r"^\s*MOTION\s*$", text, maxsplit=1, flags=re.MULTILINE)
        _, frames, values = motion.split("\n", 2)
        tail = re.match(r"\s*Frame Time:\s*([\d.eE+-]+)\s", values)
        assert tail is not None
        numbers = np.array(values[tail.end() :].split(), dtype=np.float64).reshape(int(frames.split(":")[1]), -1)
        joints = _joint_positions(head, numbers)
        hip = joints[next(iter(joints))]
        arms = [[_one_joint(joints, side, part) for side in ("left", "right")] for part in JOINTS]
        seconds = float(tail[1])
        assert len(numbers) and seconds > 0 and all(np.isfinite(each).all() for each in joints.values())
    except (ValueError, AssertionError, KeyError, IndexError, StopIteration) as error:
        raise ConfigError(
            f"{name} is not a BVH file of whole frames with hips, and arms and hands on both sides: {error}"
        ) from error
    shoulder, elbow, hand = arms
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


def _joint_positions(head: str, numbers: Array) -> dict[str, Array]:
    """Return the position (T, 3) m of each joint, z up, of the hierarchy in `head`; numbers (T, channels)."""
    frames: list[tuple[Rotation, Array]] = []
    joints: dict[str, Array] = {}
    name, column = "", 0
    offset = np.zeros(3)
    for line in head.splitlines():
        word, *rest = line.split() or [""]
        if word in ("ROOT", "JOINT", "End"):
            name = re.sub("[^a-z]", "", rest[0].split(":")[-1].lower())
        elif word == "OFFSET":
            offset = np.array(rest, dtype=np.float64)
            if name == "site":  # an end has no channels
                frames.append(frames[-1])
        elif word == "CHANNELS":
            mine = numbers[:, column : column + len(rest) - 1]
            column += len(rest) - 1
            if mine.shape[1] != len(rest) - 1:
                raise ValueError("its frames have too few numbers")
            moves = [rest.index(f"{axis}position") - 1 for axis in "XYZ" if f"{axis}position" in rest]
            turns = [index for index, channel in enumerate(rest[1:]) if channel.endswith("rotation")]
            order = "".join(rest[1 + index][0] for index in turns)
            local = Rotation.from_euler(order, mine[:, turns], degrees=True)
            shift = offset + (mine[:, moves] if len(moves) == 3 else 0.0)
            turn, origin = frames[-1] if frames else (Rotation.identity(), np.zeros((len(numbers), 3)))
            origin = origin + turn.apply(shift + np.zeros_like(origin))
            frames.append((turn * local, origin))
            joints[name] = np.stack([origin[:, 0], -origin[:, 2], origin[:, 1]], axis=-1) / 1000.0
        elif word == "}":
            frames.pop()
    return joints


def _one_joint(joints: dict[str, Array], side: str, part: str) -> Array:
    pattern = re.compile(side + JOINTS[part])
    found = [name for name in joints if pattern.fullmatch(name)]
    if not found:
        raise ValueError(f"no joint {side} {part}".replace("  ", " "))
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
