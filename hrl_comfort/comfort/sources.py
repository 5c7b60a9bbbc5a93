"""Sources of the comfort level: one level a row, constant during a decision."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from hrl_comfort.comfort.fitted import level_of, rating
from hrl_comfort.comfort.frightened import level_rate
from hrl_comfort.comfort.streams import Lsl, Recording, Signal, Stream, read_recording, udp
from hrl_comfort.config import ComfortConfig
from hrl_comfort.config import comfort as names
from hrl_comfort.config.checks import implemented

Floats = NDArray[np.float64]
Levels = Callable[[Floats, Floats], Floats]
"""(times (N,) s from the start of the episodes, draws (N, DRAWS) in [0, 1)) -> levels (N,)."""

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
    arm_distance_m: Floats
    """Smallest distance between any link and any body part; NaN where it is not measured."""


def constant(level: int | None) -> Levels:
    """Return one level for all; NaN for None."""
    return lambda time_s, draws: np.full(len(time_s), level, dtype=np.float64)


def random(config: ComfortConfig) -> Levels:
    """Return one uniformly random level an episode."""
    return lambda time_s, draws: 1.0 + np.floor(draws[:, 0] * config.levels)


def changing(config: ComfortConfig) -> Levels:
    """Return random levels that last exponential times of mean `change_s`; DRAWS / 2 levels, then repeated."""

    def levels(time_s: Floats, draws: Floats) -> Floats:
        ends = np.cumsum(-config.change_s * np.log1p(-draws[:, DRAWS // 2 :]), axis=1)
        which = ((time_s % ends[:, -1])[:, None] >= ends).sum(axis=1)
        return 1.0 + np.floor(draws[np.arange(len(which)), which] * config.levels)

    return levels


def recorded(recording: Recording) -> Levels:
    """Return levels known in advance, restarted every episode."""
    return lambda time_s, draws: recording.level(time_s)


class Live:
    """Levels of a live stream, read by wall clock; all rows have the same."""

    def __init__(self, config: ComfortConfig, stream: Stream) -> None:
        self.config, self.stream, self._signal = config, stream, Signal(config, config.source)

    def __call__(self, time_s: Floats, draws: Floats) -> Floats:
        """See `Levels`."""
        return np.full(len(time_s), float(self._signal.level(self.stream.read())))

    @property
    def stalled(self) -> bool:
        """Whether no good value has come for `comfort.stream.stall_s`."""
        return self._signal.stalled


class LiveLevels:
    """Live levels of several sources, which read the same streams; each stays open until all are closed."""

    def __init__(self) -> None:
        self._open: dict[tuple[str, str, int, str], Live] = {}

    def of(self, config: ComfortConfig) -> Live | None:
        """Return the levels of `config`, None if they are not live.

        Raises:
          ConfigError: the stream cannot be opened.
        """
        if config.source not in LIVE:
            return None
        stream = config.stream
        key = config.source, stream.host, stream.port, stream.name
        if key not in self._open:
            self._open[key] = Live(config, LIVE[config.source](config))
        elif self._open[key].config != config:
            self._open[key] = Live(config, self._open[key].stream)
        return self._open[key]

    def close(self) -> None:
        """Free what the streams listen on."""
        for live in self._open.values():
            live.stream.close()


class Source:
    """The levels of N rows by a source that knows time alone.

    Args:
      config: of the source.
      rows: number N of rows.
      levels: those of `config`, where they are opened and closed elsewhere.
    """

    def __init__(self, config: ComfortConfig, rows: int, levels: Levels | None = None) -> None:
        self.config = config
        self.draws: Floats = np.zeros((rows, DRAWS))
        self.person: NDArray[np.int64] = np.zeros(rows, dtype=np.int64)
        self.level: Floats = np.full(rows, np.nan)
        self.levels = SOURCES[config.source](config) if levels is None else levels
        self._given = levels is not None

    def close(self) -> None:
        """Free what a live stream of its own listens on."""
        if isinstance(self.levels, Live) and not self._given:
            self.levels.stream.close()

    def begin(self, rows: NDArray[np.int64]) -> None:
        """Start an episode in `rows`; their `draws` and `person` are set."""
        self.level[rows] = self.levels(np.zeros(len(self.level)), self.draws)[rows]

    def advance(self, now: SourceInput) -> Floats:
        """Return the levels (N,) of the next decision."""
        self.level = self.levels(now.time_s, self.draws)
        return self.level.copy()

    def state_dict(self) -> dict[str, Any]:
        """Return the state for a bit-identical continuation."""
        return {name: torch.from_numpy(getattr(self, name).copy()) for name in ("draws", "person", "level")}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self.draws, self.person, self.level = (saved[name].numpy().copy() for name in ("draws", "person", "level"))


class Simulated(Source):
    """A level that starts at N_c, falls with closeness and speed of the robot and recovers with time."""

    def __init__(self, config: ComfortConfig, rows: int) -> None:
        super().__init__(config, rows)
        self._exact: Floats = np.full(rows, float(config.levels))

    def begin(self, rows: NDArray[np.int64]) -> None:
        """See `Source`."""
        self._exact[rows] = self.level[rows] = float(self.config.levels)

    def advance(self, now: SourceInput) -> Floats:
        """See `Source`."""
        rate = RATES[self.config.source](self._exact, now, self.config)
        self._exact = np.clip(self._exact + rate * now.passed_s, 1.0, float(self.config.levels))
        self.level = np.round(self._exact)
        return self.level.copy()

    def state_dict(self) -> dict[str, Any]:
        """See `Source`."""
        return {**super().state_dict(), "exact": torch.from_numpy(self._exact.copy())}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """See `Source`."""
        super().load_state_dict(saved)
        self._exact = saved["exact"].numpy().copy()


class Fitted(Source):
    """The level that a person's rating of the latest decision stands for; at first that of an arm far away."""

    def begin(self, rows: NDArray[np.int64]) -> None:
        """See `Source`."""
        self.level[rows] = self._levels(np.full(len(self.level), np.inf), np.zeros(len(self.level)))[rows]

    def advance(self, now: SourceInput) -> Floats:
        """See `Source`."""
        self.level = self._levels(now.arm_distance_m, now.speed_m_s)
        return self.level.copy()

    def _levels(self, arm_distance_m: Floats, speed_m_s: Floats) -> Floats:
        rated = rating(*map(torch.from_numpy, (arm_distance_m, speed_m_s, self.person)))
        levels: Floats = level_of(rated, self.config.levels).numpy()
        return levels


def stressed(level: Floats, now: SourceInput, config: ComfortConfig) -> Floats:
    """Return d(level)/dt = (N_c - level) / recovery_s - 2 (N_c - 1) stress / stress_s, (N,) 1/s.

    stress = max(0, 1 - d / near) (1 + min(v / fast, 1)) / 2. A model for tests, not fitted to people.
    """
    person, top = config.person, float(config.levels)
    close = np.maximum(0.0, 1.0 - now.distance_m / person.near_m)
    stress = close * (1.0 + np.minimum(now.speed_m_s / person.fast_m_s, 1.0)) / 2.0
    rate: Floats = (top - level) / person.recovery_s - 2.0 * (top - 1.0) * stress / person.stress_s
    return rate


RATES: dict[str, Callable[[Floats, SourceInput, ComfortConfig], Floats]] = {
    "simulated": stressed,
    "frightened": lambda level, now, config: level_rate(level, now.arm_distance_m, now.speed_m_s, config),
}
"""Changes (N,) of levels (N,), 1/s, of people who react to the robot."""
LIVE: dict[str, Callable[[ComfortConfig], Stream]] = {"udp": udp, "lsl": Lsl}
_SOURCES: dict[str, Callable[[ComfortConfig], Levels]] = {
    "none": lambda config: constant(None),
    "fixed": lambda config: constant(config.level),
    "random": random,
    "changing": changing,
    "schedule": lambda config: recorded(Recording(np.array(config.schedule_s), np.array(config.schedule_levels))),
    "file": lambda config: recorded(read_recording(config)),
    **dict.fromkeys(LIVE, lambda config: Live(config, LIVE[config.source](config))),
    **dict.fromkeys((*RATES, "fitted"), lambda config: constant(config.levels)),
}
SOURCES = implemented(names.SOURCES, _SOURCES)


def make_source(config: ComfortConfig, rows: int, live: Live | None = None) -> Source:
    """Return the source `config.source` for N rows, of `live` levels if they are given.

    Raises:
      ConfigError: a recording is bad, or a stream cannot be opened.
    """
    if live is not None:
        return Source(config, rows, live)
    kinds = {"fitted": Fitted, **dict.fromkeys(RATES, Simulated)}
    return kinds.get(config.source, Source)(config, rows)
