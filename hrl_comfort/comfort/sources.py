"""Sources of the comfort level: one level a row, constant during a decision."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from hrl_comfort.comfort.streams import Lsl, Recording, Signal, Stream, Udp, read_recording
from hrl_comfort.config import ComfortConfig

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

DRAWS = 32
"""Uniform random numbers that a source gets each episode."""


@dataclass(frozen=True)
class SourceInput:
    """Inputs of a source after a decision, (N,) each."""

    time_s: Floats
    """Time since the start of the episode."""
    passed_s: Floats
    """Duration of the decision."""
    distance_m: Floats
    """Horizontal distance from the tool to the human's axis."""
    speed_m_s: Floats
    """Mean speed of the tool in the decision."""


class Source:
    """Base of all sources; as `source=none` it has no level (NaN)."""

    def __init__(self, config: ComfortConfig, rows: int) -> None:
        self.config = config
        self.draws: Floats = np.zeros((rows, DRAWS))
        self.level: Floats = np.full(rows, np.nan)

    def begin(self, rows: Rows) -> None:
        """Start an episode in `rows`; their `draws` are set."""
        self.level[rows] = self.at(np.zeros(len(self.level)))[rows]

    def advance(self, now: SourceInput) -> Floats:
        """Return the levels (N,) of the next decision."""
        self.level = self.at(now.time_s)
        return self.level.copy()

    def at(self, time_s: Floats) -> Floats:
        """Return the levels (N,) at times (N,) s from the start of the episodes, for sources of time alone."""
        return np.full(len(time_s), np.nan)

    def state_dict(self) -> dict[str, Any]:
        """Return the state for a bit-identical continuation."""
        return {name: torch.from_numpy(getattr(self, name).copy()) for name in ("draws", "level")}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self.draws, self.level = saved["draws"].numpy().copy(), saved["level"].numpy().copy()


class Random(Source):
    """One uniformly random level an episode."""

    def at(self, time_s: Floats) -> Floats:
        """See `Source`."""
        return 1.0 + np.floor(self.draws[:, 0] * self.config.levels)


class Changing(Source):
    """Random levels that last exponential times of mean `change_s`; DRAWS / 2 levels, then repeated."""

    def at(self, time_s: Floats) -> Floats:
        """See `Source`."""
        half = DRAWS // 2
        ends = np.cumsum(-self.config.change_s * np.log1p(-self.draws[:, half:]), axis=1)
        time_s = time_s % ends[:, -1]
        which = (time_s[:, None] >= ends).sum(axis=1)
        return 1.0 + np.floor(self.draws[np.arange(len(which)), which] * self.config.levels)


class Recorded(Source):
    """Levels known in advance, restarted every episode: fixed, a schedule or a recording."""

    def __init__(self, config: ComfortConfig, rows: int) -> None:
        super().__init__(config, rows)
        self._recording = RECORDINGS[config.source](config)

    def at(self, time_s: Floats) -> Floats:
        """See `Source`."""
        return self._recording.level(time_s)


class Live(Source):
    """A live stream, read by wall clock; all rows have the same level."""

    def __init__(self, config: ComfortConfig, rows: int) -> None:
        super().__init__(config, rows)
        self.stream = STREAMS[config.source](config)
        self._signal = Signal(config, config.source)

    def at(self, time_s: Floats) -> Floats:
        """See `Source`."""
        return np.full(len(time_s), float(self._signal.level(self.stream.read())))


class Simulated(Source):
    """A level that falls with closeness and speed of the tool and recovers with time.

    d(level)/dt = -2 (N_c - 1) stress / stress_s + (N_c - level) / recovery_s, with
    stress = max(0, 1 - d / near) (1 + min(v / fast, 1)) / 2. A model for tests, not fitted to people.
    """

    def __init__(self, config: ComfortConfig, rows: int) -> None:
        super().__init__(config, rows)
        self._exact: Floats = np.full(rows, float(config.levels))

    def begin(self, rows: Rows) -> None:
        """See `Source`; the episode starts at level N_c."""
        self._exact[rows] = self.level[rows] = float(self.config.levels)

    def advance(self, now: SourceInput) -> Floats:
        """See `Source`."""
        person, top = self.config.person, float(self.config.levels)
        close = np.maximum(0.0, 1.0 - now.distance_m / person.near_m)
        stress = close * (1.0 + np.minimum(now.speed_m_s / person.fast_m_s, 1.0)) / 2.0
        fall = 2.0 * (top - 1.0) * stress / person.stress_s
        rise = (top - self._exact) / person.recovery_s
        self._exact = np.clip(self._exact + (rise - fall) * now.passed_s, 1.0, top)
        self.level = np.round(self._exact)
        return self.level.copy()

    def state_dict(self) -> dict[str, Any]:
        """See `Source`."""
        return {**super().state_dict(), "exact": torch.from_numpy(self._exact.copy())}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """See `Source`."""
        super().load_state_dict(saved)
        self._exact = saved["exact"].numpy().copy()


RECORDINGS: dict[str, Callable[[ComfortConfig], Recording]] = {
    "fixed": lambda config: Recording(np.zeros(1), np.array([config.level], dtype=np.float64)),
    "schedule": lambda config: Recording(
        np.array(config.schedule_s), np.array(config.schedule_levels, dtype=np.float64)
    ),
    "file": read_recording,
}
STREAMS: dict[str, Callable[[ComfortConfig], Stream]] = {"udp": Udp, "lsl": Lsl}
SOURCES: dict[str, type[Source]] = {
    "none": Source,
    "fixed": Recorded,
    "random": Random,
    "changing": Changing,
    "schedule": Recorded,
    "file": Recorded,
    "udp": Live,
    "lsl": Live,
    "simulated": Simulated,
}


def make_source(config: ComfortConfig, rows: int) -> Source:
    """Return the source `config.source` for N rows; raise ConfigError at a bad recording or stream."""
    return SOURCES[config.source](config, rows)
