"""State of a walk, keep-out discs and the gait, shared by all motions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import HumanConfig
from hrl_comfort.instants import chosen, ended_early

Array = NDArray[np.float64]

NOISE = 3
"""Uniform numbers in [0, 1) that a motion gets each control step."""
STRIDE_M = 1.4
"""Distance walked in one gait cycle (two steps) of an adult."""
FULL_SWING_RAD, FULL_SWING_SPEED_M_S = np.radians(25.0), 1.0
MEMORY, TRAITS = 3, 3
SPEED_SMOOTHING = 0.05
"""Weight of the latest step in the low-pass filter of the walking speed."""
MARGIN_M = 1e-6
WALKING_M_S = 0.1
"""People who are faster over a decision walk."""


@dataclass(frozen=True)
class Walk:
    """State of n humans: position (n, 2) m, yaw (n,) rad, spawn (n, 2) m, and gait."""

    position: Array
    yaw: Array
    spawn: Array
    walked_m: Array
    """(n,) distance walked."""
    speed_m_s: Array
    """(n,) low-pass filtered."""
    step: NDArray[np.int64]
    """(n,) control steps since the start."""
    velocity: Array
    """(n, 3) in the last control step: x and y (m/s), yaw (rad/s)."""
    limbs: Array
    """(n, 6, 3) unit vectors down legs, upper arms and forearms, left first, in the person's frame: x forward, y left,
    z up. NaN is the direction of the gait."""
    memory: Array
    """(n, MEMORY) numbers of the motion's own, 0 at the start."""
    traits: Array
    """(n, TRAITS) in [0, 1), of the episode: which motion of a mixture, how fast or which recording, from when."""
    retreat: NDArray[np.int64]
    """(n,) control steps left of a retreat from the arm."""

    def rows(self, index: NDArray[np.int64]) -> Walk:
        """Return the walks of the rows `index`."""
        return Walk(**{name: value.take(index, axis=0) for name, value in vars(self).items()})

    def proposed(self) -> tuple[Array, Array, Array, Array]:
        """Return copies of position, yaw, limbs and memory: what motions propose to change."""
        return self.position.copy(), self.yaw.copy(), self.limbs.copy(), self.memory.copy()

    def copy(self) -> Walk:
        """Return the same walks, in arrays of their own."""
        return Walk(**{name: value.copy() for name, value in vars(self).items()})

    def part(self, at: slice | NDArray[np.int64]) -> Walk:
        """Return the walks of the rows `at`; without copying those of a slice."""
        return Walk(**{name: value[at] for name, value in vars(self).items()})

    def put(self, index: NDArray[np.int64], other: Walk) -> Walk:
        """Return a copy with the rows at `index` replaced by `other`."""
        replaced = {}
        for field in fields(self):
            value = getattr(self, field.name).copy()
            value[index] = getattr(other, field.name)
            replaced[field.name] = value
        return Walk(**replaced)

    @classmethod
    def joined(cls, walks: Sequence[Walk]) -> Walk:
        """Return the rows of all `walks`, those of one after those of the other."""
        return cls(**{f.name: np.concatenate([getattr(walk, f.name) for walk in walks]) for f in fields(cls)})

    @classmethod
    def chosen(cls, walks: Sequence[Walk], index: NDArray[np.int64]) -> Walk:
        """Return n humans of whom each is as in the one of `walks` that `index` (n,) names."""
        if (index == index[0]).all():
            return walks[index[0]]
        early = ended_early(index, len(walks))
        return cls(**{f.name: chosen([getattr(each, f.name) for each in walks], early) for f in fields(cls)})


@dataclass(frozen=True)
class KeepOut:
    """Discs that humans must not enter: centres (n, g, 2) m and their radius."""

    centres: Array
    radius_m: float

    def entered(self, position: Array) -> NDArray[np.bool_]:
        """Return (n,) bool: position (n, 2) m lies in a disc."""
        if not self.centres.shape[1]:
            return np.zeros(len(position), dtype=bool)
        return np.asarray((length(position[:, None] - self.centres) < self.radius_m).any(axis=1))

    def rim(self, position: Array) -> Array:
        """Return position (n, 2) m moved radially to just outside the nearest disc."""
        offset = position[:, None] - self.centres
        nearest = np.arange(len(position)), length(offset).argmin(axis=1)
        out = offset[nearest]
        span = np.maximum(length(out), 1e-9)[:, None]
        return np.asarray(self.centres[nearest] + out / span * (self.radius_m + 1e-9))


ArmSource = Callable[[], tuple[Array, Array]]
"""Return points of the arm (n, P, 3) m, at least one a link, and their velocities (n, P, 3) m/s."""


@dataclass(frozen=True)
class Surroundings:
    """The robot beside n people, as they see it, and where they must not go."""

    tcp: Array
    """(n, 2) m, tool centre point."""
    keep_out: KeepOut
    arm: ArmSource
    stations: Array
    """(n, S, 2) m, where those who live there work."""
    held: NDArray[np.int64]
    """(n,) index in `cell.objects` of the kind of object that the robot holds, -1 if none."""

    def copy(self) -> Walk:
        """Return the same walks, in arrays of their own."""
        return Walk(**{name: value.copy() for name, value in vars(self).items()})

    def part(self, at: slice | NDArray[np.int64]) -> Surroundings:
        """Return the surroundings of the rows `at`."""
        discs = KeepOut(self.keep_out.centres[at], self.keep_out.radius_m)
        return Surroundings(self.tcp[at], discs, lambda: _rows_of(self.arm(), at), self.stations[at], self.held[at])


def _rows_of(arm: tuple[Array, Array], at: slice | NDArray[np.int64]) -> tuple[Array, Array]:
    return arm[0][at], arm[1][at]


@dataclass(frozen=True)
class Stride:
    """Proposal of a motion for the end of a control step; see the fields of Walk. None leaves a field as it is."""

    position: Array
    yaw: Array
    limbs: Array | None = None
    memory: Array | None = None


Motion = Callable[[HumanConfig, Walk, Array, Surroundings], Stride | tuple[Array, Array]]
"""(config, walk, noise (n, NOISE), surroundings) -> stride, or position (n, 2) m and yaw (n,) rad alone."""


def length(vectors: Array) -> Array:
    """Return the lengths (...,) of vectors (..., 2); faster than `np.linalg.norm` on short arrays."""
    squares = vectors * vectors
    return np.asarray(np.sqrt(squares[..., 0] + squares[..., 1]))


def facing_base(position: Array) -> Array:
    """Return the yaw (n,) rad that faces the robot's base from position (n, 2)."""
    return np.arctan2(-position[:, 1], -position[:, 0])


def outside(position: Array, keep_out: KeepOut) -> Array:
    """Return position (n, 2) m, points inside a disc replaced by the nearest point outside all discs."""
    inside = keep_out.entered(position)
    moved = position.copy()
    if inside.any():
        moved[inside] = _nearest_free(position[inside], keep_out.centres[inside], keep_out.radius_m + MARGIN_M)
    return moved


def _nearest_free(points: Array, centres: Array, radius: float) -> Array:
    """Return the free point (m, 2) nearest to each of `points` (m, 2), for discs around `centres` (m, g, 2).

    The candidates are radial projections onto each rim and the intersections of two rims.
    """
    offset = points[:, None] - centres
    length = np.linalg.norm(offset, axis=-1, keepdims=True)
    away = np.where(length > MARGIN_M, offset / np.maximum(length, MARGIN_M), [1.0, 0.0])
    radial = centres + away * radius

    first, second = np.triu_indices(centres.shape[1], 1)
    half = (centres[:, second] - centres[:, first]) / 2
    gap = np.linalg.norm(half, axis=-1, keepdims=True)
    across = np.stack([-half[..., 1], half[..., 0]], axis=-1) / np.maximum(gap, MARGIN_M)
    across = across * np.sqrt(np.maximum(radius**2 - gap**2, 0.0))
    middle = (centres[:, first] + centres[:, second]) / 2

    tried = np.concatenate([radial, middle + across, middle - across], axis=1)
    clearance = np.linalg.norm(tried[:, :, None] - centres[:, None], axis=-1).min(axis=2)
    distance = np.linalg.norm(tried - points[:, None], axis=-1)
    distance = np.where(clearance >= radius - MARGIN_M / 2, distance, np.inf)
    return tried[np.arange(len(points)), distance.argmin(axis=1)]


def gait(walk: Walk) -> tuple[Array, Array]:
    """Return the phase (n,) rad and swing amplitude (n,) rad of the limbs."""
    swing = FULL_SWING_RAD * np.minimum(walk.speed_m_s / FULL_SWING_SPEED_M_S, 1.0)
    return 2 * np.pi * walk.walked_m / STRIDE_M, swing


def habits(stood: Array, side: Array, before: Array, after: Array, lasted: Array) -> Array:
    """Return `stood` s and `side` (P, N) of people after a decision of `lasted` (N,) s, stacked.

    They went from `before` to `after` (N, P, 2) m.
    """
    speed = length(after - before).T / lasted
    walked = speed > WALKING_M_S
    turn = np.sign(before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0]).T
    return np.stack([np.where(walked, 0.0, stood + lasted), np.where(walked, turn, side)])
