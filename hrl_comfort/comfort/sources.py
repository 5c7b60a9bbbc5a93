"""Where the comfort level comes from: N rows of a level each, in force for a decision at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from hrl_comfort.comfort.streams import Lsl, Recording, Signal, Stream, Udp, read_recording
from hrl_comfort.config import ComfortConfig, ConfigError

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

DRAWS = 32
"""Uniform numbers an episode gives its source."""


@dataclass(frozen=True)
class Moment:
    """What a source may look at after a decision, (N,) each."""

    time_s: Floats
    """Since the episode began."""
    passed_s: Floats
    """Duration of the decision."""
    distance_m: Floats
    """Horizontal, tool to the human's axis."""
    speed_m_s: Floats
    """Of the tool, over the decision."""


class Source:
    """No level at all (`source=none`), and what all sources share."""

    def __init__(self, config: ComfortConfig, rows: int) -> None:
        self.config = config
        self.draws: Floats = np.zeros((rows, DRAWS))
        self.level: Floats = np.full(rows, np.nan)

    def begin(self, rows: Rows) -> None:
        """Begin an episode in `rows`, whose `draws` are set."""
        self.level[rows] = self.at(np.zeros(len(self.level)))[rows]

    def advance(self, now: Moment) -> Floats:
        """Return the levels (N,) of the decision to come."""
        self.level = self.at(now.time_s)
        return self.level.copy()

    def at(self, time_s: Floats) -> Floats:
        """Return the levels (N,) at times (N,) into the episodes, for sources that follow the clock alone."""
        return np.full(len(time_s), np.nan)

    def state_dict(self) -> dict[str, Any]:
        """Return everything a bit-for-bit continuation needs."""
        return {name: torch.from_numpy(getattr(self, name).copy()) for name in ("draws", "level")}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self.draws, self.level = saved["draws"].numpy().copy(), saved["level"].numpy().copy()


class Fixed(Source):
    """`comfort.level`, always."""

    def at(self, time_s: Floats) -> Floats:
        """See `Source`."""
        assert self.config.level is not None
        return np.full(len(time_s), float(self.config.level))


class Random(Source):
    """One level an episode, each as likely."""

    def at(self, time_s: Floats) -> Floats:
        """See `Source`."""
        return 1.0 + np.floor(self.draws[:, 0] * self.config.levels)


class Changing(Source):
    """A level drawn anew after times of exponential length, mean `change_s`, within an episode.

    After the last of its draws, DRAWS / 2 levels, they come round again.
    """

    def at(self, time_s: Floats) -> Floats:
        """See `Source`."""
        half = DRAWS // 2
        ends = np.cumsum(-self.config.change_s * np.log1p(-self.draws[:, half:]), axis=1)
        time_s = time_s % ends[:, -1]
        which = (time_s[:, None] >= ends).sum(axis=1)
        return 1.0 + np.floor(self.draws[np.arange(len(which)), which] * self.config.levels)


class Schedule(Source):
    """`comfort.schedule_levels` from the times `comfort.schedule_s` on."""

    def at(self, time_s: Floats) -> Floats:
        """See `Source`."""
        times, levels = np.array(self.config.schedule_s), np.array(self.config.schedule_levels)
        # A decision that begins at a listed time, to rounding, is under the level of that time.
        return np.asarray(levels.astype(np.float64)[np.searchsorted(times, time_s + 1e-9, side="right") - 1])


class File(Source):
    """A recording of `comfort.file`, from its start in every episode."""

    def __init__(self, config: ComfortConfig, rows: int) -> None:
        super().__init__(config, rows)
        assert config.file is not None
        self._recording: Recording = read_recording(config)

    def at(self, time_s: Floats) -> Floats:
        """See `Source`."""
        return self._recording.level(time_s)


class Live(Source):
    """A stream that goes on while the robot moves: the same level in every row, by the wall clock."""

    def __init__(self, config: ComfortConfig, rows: int) -> None:
        super().__init__(config, rows)
        make: dict[str, Callable[[ComfortConfig], Stream]] = {"udp": Udp, "lsl": Lsl}
        self.stream = make[config.source](config)
        self._signal = Signal(config, config.source)

    def at(self, time_s: Floats) -> Floats:
        """See `Source`."""
        return np.full(len(time_s), float(self._signal.level(self.stream.read())))


class Simulated(Source):
    """A person whose level falls with the tool's closeness and speed and recovers with time.

    With c = N_c - 1 levels of range, stress = max(0, 1 - d / near) (1 + v / fast) / 2 in [0, 1]:
    d(level)/dt = -2 c stress / stress_s + (N_c - level) / recovery_s. A model made for tests and
    demonstrations; it is not fitted to people.
    """

    def __init__(self, config: ComfortConfig, rows: int) -> None:
        super().__init__(config, rows)
        self._exact: Floats = np.full(rows, float(config.levels))

    def begin(self, rows: Rows) -> None:
        """See `Source`: everybody begins at ease."""
        self._exact[rows] = self.level[rows] = float(self.config.levels)

    def advance(self, now: Moment) -> Floats:
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


SOURCES: dict[str, type[Source]] = {
    "none": Source,
    "fixed": Fixed,
    "random": Random,
    "changing": Changing,
    "schedule": Schedule,
    "file": File,
    "udp": Live,
    "lsl": Live,
    "simulated": Simulated,
}


def make_source(config: ComfortConfig, rows: int) -> Source:
    """Return the source that `config.source` names, for N rows.

    Raises:
      ConfigError: no such source, a bad recording, or a stream that cannot be opened.
    """
    if config.source not in SOURCES:
        raise ConfigError(f"comfort.source={config.source!r} is not allowed; choose one of {', '.join(SOURCES)}")
    return SOURCES[config.source](config, rows)
