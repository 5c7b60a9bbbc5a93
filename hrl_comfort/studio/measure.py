"""`hrl-comfort bench studio`: what the live view takes and gives, with one viewer."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
import urllib.request
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from random import Random
from typing import Any

import msgspec.msgpack
import numpy as np
import viser
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from hrl_comfort.analysis.tables import markdown
from hrl_comfort.config import ConfigError, StudioConfig
from hrl_comfort.files.output import output_file
from hrl_comfort.files.tables import write_table
from hrl_comfort.studio.page import KEYS_PATH
from hrl_comfort.studio.play import Watcher
from hrl_comfort.studio.server import LiveStudio

MEASURED_S = 30.0
"""Wall-clock time over which rates are measured."""
SETTLE_S = 5.0
PRESSES = 20
PATIENCE_S = 60.0
COLUMNS = ("what", "measured", "wanted")
MOVED_M = 1e-3


class Viewer:
    """A viewer without a browser: counts the pictures that it is sent.

    Args:
      address: of the page.
    """

    def __init__(self, address: str) -> None:
        self.pictures = 0
        """Windows of messages that turned or moved a body."""
        self.moved = threading.Event()
        """A body that had been seen has been seen elsewhere."""
        self._seen: set[str] = set()
        self._socket = connect(
            address.replace("http", "ws", 1),
            subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
            max_size=None,
        )
        self._thread = threading.Thread(target=self._read, name="viewer", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Leave the page."""
        self._socket.close()
        self._thread.join(timeout=10.0)

    def _read(self) -> None:
        with suppress(ConnectionClosed):
            for data in self._socket:
                assert isinstance(data, bytes)
                names = turned(data)
                self.pictures += bool(names)
                if names & self._seen:
                    self.moved.set()
                self._seen |= names


def turned(data: bytes) -> set[str]:
    """Return the names of the bodies that a window of viser's messages turns."""
    packed = data[16 : 16 + int.from_bytes(data[8:16], "little")]
    window: dict[str, Any] = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(packed))
    return {each["name"] for each in window["messages"] if each["type"] == "SetOrientationMessage"}


@dataclass
class Seen(Watcher):
    """A watcher that notes when a person who stood has moved in the state of the next decision."""

    from_m: np.ndarray | None = None
    at_s: float | None = None
    decisions: int = 0

    def stepped(self, cell: int, session: Any, step: Any) -> None:
        """See `play.Watcher`; the policy has acted on the state by now."""
        if self.from_m is not None and self.at_s is None:
            self.decisions += 1
            if np.abs(session.state.humans_pos[0, 0].numpy() - self.from_m).max() > MOVED_M:
                self.at_s = time.monotonic()


def bench_studio(config: StudioConfig) -> Path:
    """Measure first sight, frames, real time, load and latency; then play `episodes` episodes by a script.

    Write what was measured to studio.csv and return it.

    Raises:
      ConfigError: the replay is to be measured.
    """
    if config.replay is not None:
        raise ConfigError(f"replay={config.replay!r}: a live studio is measured; leave it out")
    path, config = Path(config.output) / "studio.csv", replace(config, port=0)
    with output_file(path):
        rows = [("load of the machine at the beginning, processes", f"{os.getloadavg()[0]:.1f}", ""), *first_sight()]
        studio = LiveStudio(config)
        studio.start()
        try:
            rows += [*rates(studio), *latency(studio), *hours(studio, config.episodes)]
        finally:
            studio.stop()
        write_table(path, COLUMNS, rows)
    print(markdown(COLUMNS, rows), end="")
    return path


def first_sight() -> list[tuple[str, str, str]]:
    """Return how long `hrl-comfort studio` takes from the command to the first picture of a moving arm."""
    began = time.monotonic()
    command = [sys.executable, "-m", "hrl_comfort", "studio", "port=0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        line = next((each for each in process.stdout if each.startswith("studio: ")), None)
        try:
            if line is None:
                raise ConfigError("hrl-comfort studio port=0 printed no address")
            viewer = Viewer(line.split()[1])
            viewer.moved.wait(PATIENCE_S)
            seen_s = time.monotonic() - began
            used_s = cpu_s(process.pid)
            viewer.close()
        finally:
            process.terminate()
    return [
        ("first sight, s", f"{seen_s:.1f}", "<= 10"),
        ("first sight, s of processor time", f"{used_s:.1f}", ""),
    ]


def cpu_s(pid: int) -> float:
    """Return the processor time that a process has used, s; NaN where /proc does not say."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    except OSError:
        return float("nan")
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def rates(studio: LiveStudio) -> list[tuple[str, str, str]]:
    """Return frames a second, drift and load with one viewer."""
    viewer = Viewer(studio.page.address)
    studio.play.hold_s = 0.0  # nothing moves between two episodes
    time.sleep(SETTLE_S)

    def now() -> np.ndarray:
        return np.array([time.monotonic(), time.process_time(), viewer.pictures, studio.loop.lost_s])

    began = now()
    time.sleep(MEASURED_S)
    wall_s, used_s, pictures, lost_s = now() - began
    viewer.close()
    return [
        ("frames/s at a viewer", f"{pictures / wall_s:.1f}", ">= 30"),
        ("drift of simulated against wall-clock time, %", f"{100 * lost_s / wall_s:.2f}", "< 1"),
        ("share of one core, %", f"{100 * used_s / wall_s:.0f}", "<= 60"),
    ]


def latency(studio: LiveStudio) -> list[tuple[str, str, str]]:
    """Return how long a key's request takes to the policy's action on a state with the person elsewhere.

    It waits for the decision under way to end, which alone takes up to `Session.decision_s`.
    """
    rng, seen, delays_s, decisions = Random(0), Seen(), [], []
    studio.play.watchers.insert(0, seen)  # the page is told afterwards
    for turn in range(PRESSES):
        time.sleep(rng.uniform(0.5, 1.0))
        place = studio.sessions[0].state.humans_pos[0, 0].numpy().copy()
        seen.from_m, seen.at_s, seen.decisions = place, None, 0
        began = time.monotonic()
        while seen.at_s is None and time.monotonic() - began < PATIENCE_S:
            press(studio, "ws"[turn % 2])
            for _ in range(200):
                if seen.at_s is None:
                    time.sleep(0.001)
        delays_s.append((seen.at_s or time.monotonic()) - began)
        decisions.append(seen.decisions)
        press(studio, "")
    studio.play.watchers.remove(seen)
    middle_ms, most_ms = 1000 * np.median(delays_s), 1000 * max(delays_s)
    return [
        (
            "from hand to the policy's observation, decisions, median (most)",
            f"{np.median(decisions):.0f} ({max(decisions)})",
            "1",
        ),
        ("from hand to the policy's action, ms, median (most)", f"{middle_ms:.0f} ({most_ms:.0f})", "<= 100"),
    ]


def press(studio: LiveStudio, keys: str) -> None:
    """Hold `keys` as the page does."""
    urllib.request.urlopen(f"{studio.page.address.split('/?')[0]}{KEYS_PATH}?held={keys}", timeout=PATIENCE_S).close()


def hours(studio: LiveStudio, episodes: int) -> list[tuple[str, str, str]]:
    """Play by a script: keys, levels, resets and viewers at random; return what it took of memory, and errors."""
    rng, errors, loop = Random(0), Errors(), studio.loop
    studio.play.watchers.append(errors)
    began, viewers, memory_mb = time.monotonic(), [], [resident_mb()]
    first = studio.sessions[0].engine.episodes.episode[0]
    while (played := studio.sessions[0].engine.episodes.episode[0] - first) < episodes:
        press(studio, rng.choice(["", "w", "s", "wa", "sd", "q", "e"]))
        loop.ask(lambda: studio.sessions[0].set_level(rng.randint(1, 10)))
        if rng.random() < 0.1:
            loop.ask(studio.play.reset)
        if rng.random() < 0.1:
            viewers.append(Viewer(studio.page.address))
        if len(viewers) > 2 or (viewers and rng.random() < 0.05):
            viewers.pop(0).close()
        if len(memory_mb) == 1 and played >= episodes / 4:
            memory_mb.append(resident_mb())  # once every part has been used
        time.sleep(0.3)
    for viewer in viewers:
        viewer.close()
    studio.play.watchers.remove(errors)
    grown = 100 * (resident_mb() / memory_mb[-1] - 1)
    return [
        (f"scripted play of {(time.monotonic() - began) / 60:.1f} min: errors", str(errors.count), "0"),
        ("memory at its end against its first quarter, %", f"{grown:+.1f}", "within 5"),
    ]


class Errors(Watcher):
    """A watcher that counts failures."""

    def __init__(self) -> None:
        self.count = 0

    def failed(self, error: Exception) -> None:
        """See `play.Watcher`."""
        self.count += 1


def resident_mb() -> float:
    """Return the memory of this process, MB; NaN where /proc does not say."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return float("nan")
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
