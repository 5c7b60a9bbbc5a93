"""Human motions: each proposes position (n, 2) m and yaw (n,) rad of n humans one control step (20 ms) on."""

import csv
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S, FAR_AWAY_M, ConfigError, HumanConfig
from hrl_comfort.config.checks import FARTHEST
from hrl_comfort.humans.live import live
from hrl_comfort.humans.walk import Array, Motion, Walk, facing_base, length

HEADER = ["t", "x", "y", "yaw"]
FULL_TURN_RAD = 2 * np.pi
EPSILON_RAD = EPSILON_M = 1e-9


def none(config: HumanConfig, walk: Walk, noise: Array, tcp: Array) -> tuple[Array, Array]:
    """Stay far away: no human is in the cell."""
    return np.tile([FAR_AWAY_M, 0.0], (len(walk.yaw), 1)), np.zeros(len(walk.yaw))


def still(config: HumanConfig, walk: Walk, noise: Array, tcp: Array) -> tuple[Array, Array]:
    """Stay at the spawn point and face the robot."""
    return walk.position, facing_base(walk.position)


def random_walk(config: HumanConfig, walk: Walk, noise: Array, tcp: Array) -> tuple[Array, Array]:
    """Move up to `jitter_m` along x and y or, with `forward_probability`, `forward_m` towards the base.

    This is the paper's "random forward walk". The paper gives no constants for it; the defaults are those of its
    released code, which also moves the human along an arc (motion `arc`).
    """
    yaw = facing_base(walk.position)
    forward = config.forward_m * np.array([np.cos(yaw), np.sin(yaw)]).T
    move = np.where(noise[:, 2:] < config.forward_probability, forward, _jitter(config, noise))
    position = walk.position + move
    return position, facing_base(position)


def arc(config: HumanConfig, walk: Walk, noise: Array, tcp: Array) -> tuple[Array, Array]:
    """Move the bearing by `arc_deg` over `arc_steps` and back; take the radius from `random_walk`.

    This is the motion of the paper's released code.
    """
    wandered, _ = random_walk(config, walk, noise, tcp)
    radius = np.linalg.norm(wandered, axis=-1)
    turns = (walk.step + 1) / config.arc_steps
    share = 1.0 - np.abs(1.0 - turns % 2.0)
    bearing = np.arctan2(walk.spawn[:, 1], walk.spawn[:, 0]) + np.radians(config.arc_deg) * share
    position = radius[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    return position, facing_base(position)


def approach(config: HumanConfig, walk: Walk, noise: Array, tcp: Array) -> tuple[Array, Array]:
    """Walk at `speed_m_s` straight to the tool centre point and face it: the paper's critical case."""
    offset = tcp - walk.position
    return walk.position + _stride(config, offset), np.arctan2(offset[:, 1], offset[:, 0])


def work(config: HumanConfig, walk: Walk, noise: Array, tcp: Array) -> tuple[Array, Array]:
    """Walk at `speed_m_s` to the station nearest to the spawn point; add jitter of up to `jitter_m` along x and y."""
    stations = np.array(config.stations_m, dtype=np.float64)
    nearest = np.linalg.norm(walk.spawn[:, None] - stations, axis=-1).argmin(axis=1)
    position = walk.position + _stride(config, stations[nearest] - walk.position) + _jitter(config, noise)
    return position, facing_base(position)


def _jitter(config: HumanConfig, noise: Array) -> Array:
    return (2 * noise[:, :2] - 1) * config.jitter_m


def _stride(config: HumanConfig, offset: Array) -> Array:
    """Return the displacement (n, 2) m of one step at `speed_m_s` along `offset` (n, 2) m, at most to its end."""
    distance = np.linalg.norm(offset, axis=-1, keepdims=True)
    return np.asarray(offset / np.maximum(distance, 1e-9) * np.minimum(config.speed_m_s * CONTROL_STEP_S, distance))


def patrol(config: HumanConfig, walk: Walk, noise: Array, tcp: Array) -> tuple[Array, Array]:
    """Walk around the robot to the next of `stations_m`, stay there for `stay_s` on average, and repeat.

    The stay has an exponential distribution; away from a station the human leaves at once. The direction is
    drawn on leaving. Yaw holds the state: a working human faces the robot, a walking one the direction.
    """
    stations = np.array(config.stations_m, dtype=np.float64)
    away = np.linalg.norm(walk.position[:, None] - stations, axis=-1).min(axis=1) > EPSILON_M
    bearing = np.arctan2(walk.position[:, 1], walk.position[:, 0])
    way = np.sign(np.round(np.sin(facing_base(walk.position) - walk.yaw), 3))
    leaving = (way == 0) & (away | (noise[:, 2] * config.stay_s < CONTROL_STEP_S))
    way = np.where(leaving, np.where(noise[:, 0] < 0.5, 1.0, -1.0), way)

    ahead = (np.arctan2(stations[:, 1], stations[:, 0]) - bearing[:, None]) * way[:, None] % FULL_TURN_RAD
    ahead = np.where(ahead < EPSILON_RAD, FULL_TURN_RAD, ahead)  # the current station is a full turn away
    goal = ahead.argmin(axis=1)
    left = ahead[np.arange(len(goal)), goal]

    radius = length(walk.position)
    outwards = length(stations)[goal] - radius
    share = np.minimum(1.0, config.speed_m_s * CONTROL_STEP_S / np.hypot(radius * left, outwards))
    turned, reached = bearing + way * left * share, radius + outwards * share
    there = reached[:, None] * np.stack([np.cos(turned), np.sin(turned)], axis=-1)

    walking, arrived = way != 0, share == 1.0
    there = np.where(arrived[:, None], stations[goal], there)
    position = np.where(walking[:, None], there, walk.position)
    facing = facing_base(position)
    return position, np.where(walking & ~arrived, facing - way * np.pi / 2, facing)


def playback(config: HumanConfig, walk: Walk, noise: Array, tcp: Array) -> tuple[Array, Array]:
    """Follow `file`; spawn, bound and keep-out do not apply."""
    return recorded_pose(config, (walk.step + 1) * CONTROL_STEP_S)


def recorded_pose(config: HumanConfig, time_s: NDArray[np.floating]) -> tuple[Array, Array]:
    """Return position and yaw at times (n,) s of the motion `file`, interpolated linearly and held at its end."""
    assert config.file is not None
    time, poses = read_motion(config.file)
    x, y, yaw = (np.interp(time_s, time, column) for column in poses.T)
    return np.stack([x, y], axis=-1), yaw


@lru_cache(maxsize=32)
def read_motion(path: str) -> tuple[Array, Array]:
    """Return times (T,) s and poses (T, 3) m, m, rad (cell frame, yaw unwrapped) of a CSV of t, x, y, yaw.

    Raises:
      ConfigError: no such file, not text, a wrong header, or a bad line (named).
    """
    name, wanted = f"human.file={path!r}", f"it must be a CSV of {','.join(HEADER)}"
    if not Path(path).is_file():
        raise ConfigError(f"{name} does not exist; {wanted}")
    try:
        header, *lines = [*csv.reader(Path(path).read_text(encoding="utf-8-sig").splitlines())] or [[]]
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{name} cannot be read: {error}; {wanted}") from error
    if [cell.strip() for cell in header] != HEADER or not lines:
        raise ConfigError(f"{name}: line 1 must be {','.join(HEADER)}, and at least one line must follow")
    rows: list[list[float]] = []
    for number, line in enumerate(lines, start=2):
        try:
            time, x, y, yaw = map(float, line)
            near = all(abs(value) <= FARTHEST for value in (x, y, yaw))
            valid = near and np.isfinite(time) and (not rows or time > rows[-1][0])
        except ValueError:
            valid = False
        if not valid:
            raise ConfigError(
                f"{name}: line {number} must be four finite numbers, t later than in the line before, "
                f"x, y and yaw within ±{FARTHEST:g}: {','.join(line)}"
            )
        rows.append([time, x, y, yaw])
    table = np.array(rows)
    return table[:, 0], np.column_stack([table[:, 1:3], np.unwrap(table[:, 3])])


MOTIONS: dict[str, Motion] = {
    each.__name__: each for each in (none, still, random_walk, arc, approach, playback, work, patrol, live)
}
UNBOUNDED = ("none", "playback", "live")
"""Motions to which `bound_m` and `keep_out_m` do not apply."""
