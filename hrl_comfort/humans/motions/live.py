"""Motion `live`: a person who walks to the newest pose of a live source."""

from __future__ import annotations

import math
import re
import time
import warnings
from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Any

import numpy as np

from hrl_comfort.config import CONTROL_STEP_S, ConfigError, HumanConfig
from hrl_comfort.config.checks import FARTHEST, import_object, is_object
from hrl_comfort.humans import body
from hrl_comfort.humans.walk import Array, Stride, Surroundings, Walk
from hrl_comfort.streams import LslStream, UdpStream

Pose = tuple[float, float, float | None]
"""x, y (m) and yaw (rad) in the cell frame; without a yaw the person faces where they walk."""
PoseSource = Callable[[], Pose | None]
"""Return the newest pose, None before the first one; it must not block."""
FORMS = "udp://HOST:PORT, lsl:NAME or package.module:callable"
APPEAR_S = 3.0
"""Time in which a stream of the Lab Streaming Layer must appear."""
ARRIVED_M = 1e-3
"""Distance below which a person without a given yaw keeps theirs."""


class HeldPose:
    """Pose that the program itself sets, such as `hrl-comfort studio`."""

    def __init__(self) -> None:
        self.pose: Pose | None = None
        self.hands: Array | None = None
        """(2, 3) m, left first, where the hands shall be in the person's frame; None lets the arms hang."""

    def __call__(self) -> Pose | None:
        """See `PoseSource`."""
        return self.pose


HELD = HeldPose()
"""The source of `human.file=null`; until a pose is set, the person stands still."""


def live(config: HumanConfig, walk: Walk, noise: Array, around: Surroundings) -> Stride:
    """Walk at up to `speed_m_s` to the newest pose of `file`; bound and keep-out do not apply.

    Hands that the program holds move at what the walk leaves of that speed.
    """
    position, yaw = _walked(config, walk)
    limbs = None if config.file is not None else _limbs(config, walk, position)
    return Stride(position, yaw, limbs)


def _walked(config: HumanConfig, walk: Walk) -> tuple[Array, Array]:
    pose = pose_source(config.file)()
    if pose is None:
        return walk.position, walk.yaw
    x, y, yaw = pose
    offset = np.array([x, y]) - walk.position
    distance = np.linalg.norm(offset, axis=-1)
    stride = np.minimum(config.speed_m_s * CONTROL_STEP_S, distance)
    position = walk.position + offset / np.maximum(distance, 1e-9)[:, None] * stride[:, None]
    if yaw is not None:
        return position, np.full(len(distance), yaw)
    return position, np.where(distance > ARRIVED_M, np.arctan2(offset[:, 1], offset[:, 0]), walk.yaw)


def _limbs(config: HumanConfig, walk: Walk, position: Array) -> Array | None:
    """Return limbs as `Walk.limbs` with the hands on their way; None where they hang and shall."""
    given = np.asarray(np.isfinite(walk.limbs[:, 2:]).all(axis=(1, 2)))
    if HELD.hands is None and not given.any():
        return None
    hands = np.where(given[:, None, None], body.hands(walk.limbs), body.HANGING)
    target = body.HANGING if HELD.hands is None else HELD.hands
    walking = np.linalg.norm(position - walk.position, axis=-1)
    stride = np.maximum(config.speed_m_s * CONTROL_STEP_S - walking, 0.0)[:, None, None]
    offset = target - hands
    distance = np.linalg.norm(offset, axis=-1, keepdims=True)
    limbs = body.reaching(hands + offset * np.minimum(1.0, stride / np.maximum(distance, 1e-9)))
    if HELD.hands is None:
        limbs[(distance < ARRIVED_M).all(axis=(1, 2))] = np.nan
    return limbs


@lru_cache(maxsize=8)
def pose_source(name: str | None) -> PoseSource:
    """Return the source of poses that `human.file` names.

    Datagrams are texts `x y` or `x y yaw`, channels of the Lab Streaming Layer x, y and perhaps yaw, in m, m, rad.

    Raises:
      ConfigError: there is no such source, or it cannot be opened.
    """
    if name is None:
        return HELD
    key = f"human.file={name!r}"
    if found := re.fullmatch(r"udp://(.+):(\d{1,5})", name):
        return CheckedPoses(name, UdpStream(found[1], int(found[2]), key).read_stamped)
    if name.startswith("lsl:"):
        return CheckedPoses(name, LslStream(name.removeprefix("lsl:"), (2, 3), APPEAR_S, key).read_stamped)
    if not is_object(name):
        raise ConfigError(f"human.file={name!r} is not a source of live poses; give {FORMS}")
    function = import_object("human.file", name)
    return CheckedPoses(name, lambda: [(function(), time.monotonic())])


class CheckedPoses:
    """Poses of an outside source; a bad one is left out, with one warning when the fault starts.

    Args:
      name: of the source, for warnings.
      read: returns the values that have arrived since the last call, oldest first, and the monotonic time, s, of
        each one's arrival; None is no value.
    """

    def __init__(self, name: str, read: Callable[[], Iterable[tuple[Any, float]]]) -> None:
        self._name, self._read = name, read
        self._pose: Pose | None = None
        self._warned = False
        self.arrived_s = -math.inf
        """Monotonic time at which the last good pose arrived."""
        self.moved: Callable[[Pose], Pose] = lambda pose: pose
        """Takes poses from the source's frame to that of the cell."""

    def __call__(self) -> Pose | None:
        """See `PoseSource`; the last good pose holds."""
        for value, arrived_s in self._read():
            if value is None:
                continue
            try:
                self._pose, self._warned = self.moved(parse_pose(value)), False
                self.arrived_s = arrived_s
            except (TypeError, ValueError) as error:
                if not self._warned:
                    warnings.warn(f"human.file={self._name!r}: {error}: not used", stacklevel=2)
                self._warned = True
        return self._pose


def parse_pose(value: Any) -> Pose:
    """Return the pose in text such as `0.4 -0.6 1.57`, or in two or three numbers.

    Raises:
      ValueError: it holds other values than x, y and perhaps yaw, finite and within ±FARTHEST.
    """
    parts = re.split(r"[\s,]+", value.strip()) if isinstance(value, str) else list(value)
    numbers = [float(part) for part in parts]
    if len(numbers) not in (2, 3) or not all(math.isfinite(number) and abs(number) <= FARTHEST for number in numbers):
        raise ValueError(f"{str(value)[:60]!r} is not x, y (m) and perhaps yaw (rad) within ±{FARTHEST:g}")
    return numbers[0], numbers[1], numbers[2] if len(numbers) == 3 else None
