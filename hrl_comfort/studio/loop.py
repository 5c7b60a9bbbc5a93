"""The real-time loop: decisions at their true rate, pictures between them, and what the page asks for."""

from __future__ import annotations

import queue
import threading
import time
import traceback
from collections.abc import Callable
from typing import Protocol

LATE_S = 1.0
"""Delay after which the loop stops catching up."""
WINDOW_S = 5.0
"""Wall-clock time over which the rate is measured."""


class Play(Protocol):
    """Play that the loop runs."""

    def advance(self) -> float:
        """Run one decision; return how much simulated time its pictures last, s."""

    def make_ready(self) -> None:
        """Begin the next episode where the last one is over, so that `advance` runs a decision."""

    def show(self, time_s: float) -> None:
        """Show the picture at a time since the latest decision began, s."""

    def failed(self, error: Exception) -> None:
        """Say that a decision, a picture or a request failed."""


class Loop:
    """Runs a `Play` in a thread of its own; every change to it is a request, run between two decisions.

    Args:
      play: what is run.
      frames_per_s: pictures a second of wall-clock time.
      speed: simulated time per wall-clock time.
    """

    def __init__(self, play: Play, frames_per_s: float, speed: float) -> None:
        self._play, self._frame_s = play, 1.0 / frames_per_s
        self.speed, self.running = speed, True
        self.rate = 1.0
        """Simulated time per wall-clock time, of what `speed` asks for, over the last WINDOW_S."""
        self.lost_s = 0.0
        """Wall-clock time by which the simulation has fallen behind since the start."""
        self._requests: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="studio loop", daemon=True)
        self._began, self._lasts = 0.0, 0.0
        self._window_began, self._window_lost_s = 0.0, 0.0

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Stop the thread, and wait for it."""
        self._requests.put(None)
        self._thread.join(timeout=10.0)

    def ask(self, request: Callable[[], None]) -> None:
        """Run `request` in the loop's thread, between two decisions."""
        self._requests.put(request)

    def set_running(self, running: bool) -> None:
        """Run or pause; for requests."""
        self.running = running
        self._began, self._lasts = time.monotonic() - self._lasts / self.speed, self._lasts
        self._restart_window()

    def set_speed(self, speed: float) -> None:
        """Change the speed; for requests."""
        now = time.monotonic()
        self._began = now - (now - self._began) * self.speed / speed
        self.speed = speed
        self._restart_window()

    def step(self) -> None:
        """Pause after one more decision; for requests."""
        self.running = False
        self._play.make_ready()
        self._advance(time.monotonic())

    def _run(self) -> None:
        self._began = time.monotonic()
        self._restart_window()
        picture = self._began
        while True:
            now = time.monotonic()
            due = self._began + self._lasts / self.speed
            if self.running and now >= due:
                self._take_late(now - due)
                self._advance(max(due, now - LATE_S))
                now = time.monotonic()
            if now >= picture:
                self._guard(lambda: self._play.show((time.monotonic() - self._began) * self.speed))
                picture = max(picture + self._frame_s, now)
            wake = min(picture, self._began + self._lasts / self.speed) if self.running else picture
            try:
                request = self._requests.get(timeout=max(0.0, wake - time.monotonic()))
            except queue.Empty:
                continue
            if request is None:
                return
            self._guard(request)

    def _advance(self, began: float) -> None:
        self._began = began
        self._lasts = 0.1
        if not self._guard(self._decide):
            self.running = False

    def _decide(self) -> None:
        self._lasts = self._play.advance()

    def _take_late(self, late_s: float) -> None:
        """Count the time lost where the loop cannot catch up."""
        self.lost_s += max(0.0, late_s - LATE_S)
        passed = time.monotonic() - self._window_began
        if passed >= WINDOW_S:
            self.rate = max(0.0, 1.0 - (self.lost_s - self._window_lost_s) / passed)
            self._restart_window()

    def _restart_window(self) -> None:
        self._window_began, self._window_lost_s = time.monotonic(), self.lost_s

    def _guard(self, action: Callable[[], None]) -> bool:
        """Return whether `action` went well; otherwise it is said on the page, and the server stands."""
        try:
            action()
        except Exception as error:  # noqa: BLE001 - whatever a policy raises, the page says it and stays
            traceback.print_exc()
            self._play.failed(error)
            return False
        return True
