"""Live and recorded signals and their conversion to comfort levels.

No bad signal stops the robot. Non-numbers and values far outside the range are ignored; the last good value
holds. After `stall_s` without a good value, the level is CAUTIOUS. Each fault gives one warning when it starts.
"""

import csv
import math
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import ComfortConfig, ConfigError
from hrl_comfort.files.reading import read_text
from hrl_comfort.streams import LslStream, UdpStream

CAUTIOUS = 1
"""The most cautious level."""


class Stream(Protocol):
    """A source of values that is read without blocking."""

    def read(self) -> Sequence[str | float]:
        """Return the values since the last call, oldest first; text is parsed as a number."""

    def close(self) -> None:
        """Free what it listens on; it is not read any more."""


class Signal:
    """Conversion of values to levels: range, smoothing, bad values and stalls; `clock` in s."""

    def __init__(self, config: ComfortConfig, name: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._config, self._name, self._clock = config, name, clock
        self._smooth: float | None = None
        self.last_good_s = -math.inf
        self._warned: set[str] = set()

    def level(self, arrived: Sequence[str | float]) -> int:
        """Process the new values; return the current level, 1 to N_c."""
        now = self._clock()
        good = [share for raw in arrived if (share := self._share(raw)) is not None]
        if good:  # only the newest of simultaneous values
            self._take(good[-1], now)
        if self._smooth is None or self.stalled:
            since = f"for {self._config.stream.stall_s:g} s" if self._smooth is not None else "has come yet"
            self._warn("stall", f"no good value {since}: level {CAUTIOUS}")
            return CAUTIOUS
        self._warned.discard("stall")
        return round(1 + self._smooth * (self._config.levels - 1))

    @property
    def stalled(self) -> bool:
        """Whether the last good value is older than `stall_s`, or none has come."""
        return self._clock() - self.last_good_s > self._config.stream.stall_s

    def _share(self, raw: str | float) -> float | None:
        """Return a value scaled to 0 (low) to 1 (high), or None, with a warning, if it is unusable."""
        stream = self._config.stream
        try:
            # float() reads "1_0" as ten
            value = math.nan if "_" in str(raw) else float(raw)
            share = (value - stream.low) / (stream.high - stream.low)
        except (TypeError, ValueError):
            share = math.nan
        if not math.isfinite(share):
            self._warn("rubbish", f"{str(raw)[:40]!r} is not a number: not used")
            return None
        if not -stream.tolerance <= share <= 1 + stream.tolerance:
            self._warn("range", f"{raw!r} is far outside [{stream.low:g}, {stream.high:g}]: not used")
            return None
        self._warned -= {"rubbish", "range"}
        return min(max(share, 0.0), 1.0)

    def _take(self, share: float, now: float) -> None:
        stream = self._config.stream
        if self._smooth is None or now - self.last_good_s > stream.stall_s or stream.smoothing_s == 0:
            self._smooth = share
        else:
            self._smooth += (share - self._smooth) * -math.expm1((self.last_good_s - now) / stream.smoothing_s)
        self.last_good_s = now

    def _warn(self, kind: str, what: str) -> None:
        if kind not in self._warned:
            self._warned.add(kind)
            warnings.warn(f"comfort.source={self._name}: {what}", stacklevel=4)


def udp(config: ComfortConfig) -> UdpStream:
    """Return the datagrams to `stream.host`:`stream.port`, one ASCII number each; raise ConfigError at a taken port."""
    stream = config.stream
    return UdpStream(stream.host, stream.port, f"comfort.stream.port={stream.port} on host {stream.host!r}")


class Lsl:
    """Values of the Lab Streaming Layer stream `stream.name`, which must have one channel and appear in `stall_s`."""

    def __init__(self, config: ComfortConfig) -> None:
        name = config.stream.name
        self._stream = LslStream(name, (1,), config.stream.stall_s, f"comfort.stream.name={name!r}")

    def read(self) -> list[float]:
        """See `Stream`."""
        return [value for (value,) in self._stream.read()]

    def close(self) -> None:
        """See `Stream`."""
        self._stream.close()


@dataclass(frozen=True)
class Recording:
    """Levels (E,), each from its time (E,) s on; times rise."""

    time_s: NDArray[np.float64]
    levels: NDArray[np.int64]

    def level(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the levels (N,) at times (N,) s; CAUTIOUS before the first value."""
        # 1e-9 s: a decision that starts at a listed time, up to rounding, has the level of that time.
        at = np.searchsorted(self.time_s, time_s + 1e-9, side="right") - 1
        return np.where(at < 0, float(CAUTIOUS), self.levels[np.maximum(at, 0)].astype(np.float64))


def read_recording(config: ComfortConfig) -> Recording:
    """Return the recording `comfort.file`, converted by a `Signal` as if it arrived live.

    The level is CAUTIOUS in gaps longer than `stall_s`, and `stall_s` after the last value.

    Raises:
      ConfigError: the file is missing or no CSV, or has other columns, no line, or times that do not rise.
    """
    name = f"comfort.file={config.file!r}"
    try:
        if not Path(config.file or "").is_file():
            raise FileNotFoundError("no such file")
        rows = list(csv.reader(read_text(Path(config.file or "")).splitlines(), strict=True))
    except (OSError, ValueError, csv.Error) as error:
        raise ConfigError(f"{name} cannot be read: {error}; it must be a CSV of t,value") from error
    while rows and not "".join(rows[-1]).strip():
        rows.pop()
    if not rows or [cell.strip() for cell in rows[0]] != ["t", "value"] or len(rows) < 2:
        raise ConfigError(f"{name} must have the columns t,value and at least one line")
    now, stall_s = 0.0, config.stream.stall_s
    signal = Signal(config, "file", clock=lambda: now)
    entries: list[tuple[float, int]] = []
    for number, row in enumerate(rows[1:], start=2):
        try:
            moment, value = float(row[0]), row[1]
            rises = moment > entries[-1][0] if entries else moment >= 0
            valid = len(row) == 2 and math.isfinite(moment) and rises
        except (ValueError, IndexError):
            valid = False
        if not valid:
            raise ConfigError(
                f"{name} line {number}: {','.join(row)[:40]!r} must be t,value with t in s that rise from 0"
            )
        if entries and moment - signal.last_good_s > stall_s and entries[-1][1] != CAUTIOUS:
            entries.append((max(signal.last_good_s + stall_s, np.nextafter(entries[-1][0], math.inf)), CAUTIOUS))
        now = moment
        entries.append((moment, signal.level([value])))
    if signal.last_good_s + stall_s > entries[-1][0]:
        entries.append((signal.last_good_s + stall_s, CAUTIOUS))
    times, levels = zip(*entries, strict=True)
    return Recording(np.array(times), np.array(levels))
