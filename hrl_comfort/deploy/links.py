"""Links of the runner to its streamer: in lockstep with it, or to a process of its own that keeps the wall clock.

The runner plans a control step while the streamer runs the one before: it gets a report as that begins.
"""

from __future__ import annotations

import gc
import os
import signal
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import ConfigError
from hrl_comfort.deploy.arms import PERIOD_S, Arm
from hrl_comfort.deploy.streamer import TICKS, Limits, Report, Streamer

Array = NDArray[np.float64]
SLIP_S = 0.010
"""Delay of the set-points of a control step by which it counts as late."""
OPEN_S = 60.0
"""Longest time for the connection to the arm, or for an answer of the streamer."""


RUNNER, STREAMER = 10, 50
"""Priorities of the processes."""


def prefer(priority: int) -> None:
    """Run this process before others and without garbage collection; 0 ends it."""
    gc.disable() if priority else gc.enable()
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO if priority else os.SCHED_OTHER, os.sched_param(priority))
    except (OSError, AttributeError):  # Linux allows it to root and with a limit `rtprio`
        if priority == RUNNER:
            warnings.warn("no real-time priority (limit rtprio): beside other work the arm may stop", stacklevel=2)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Block SIGINT; processes that are started meanwhile keep it blocked."""
    resource_tracker.ensure_running()  # its start, part of that of the first process, unblocks SIGINT
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Link(Protocol):
    """A streamer, as the runner sees it."""

    paced: bool
    """It keeps the wall clock."""
    report: Report
    """The latest one."""

    def step(self, target: Array) -> Report:
        """Give the set-point (J,) rad, with a hand (J + 1,), of the next control step; return that step's report."""

    def lay(self, objects: Array) -> None:
        """Lay the objects, see `Arm`, while the arm stands."""

    def rest(self) -> None:
        """End the plan; set-points that still move are braked."""

    def stop(self, why: str) -> Report:
        """Stop the arm by the rated brake; return the report when its set-points stand still."""

    def close(self) -> None:
        """End the connection and the log."""


class Lockstep:
    """A streamer that waits for the runner: simulated time, as fast as it goes."""

    paced = False

    def __init__(self, open_arm: Callable[[], Arm], limits: Limits, log: Path) -> None:
        self._log = log.open("wb")
        self._streamer = Streamer(open_arm(), limits, self._log)
        self.report = self._streamer.report()

    def step(self, target: Array) -> Report:
        """See `Link`."""
        self._run(target)
        return self.report

    def lay(self, objects: Array) -> None:
        """See `Link`."""
        self._streamer.arm.lay(objects)

    def rest(self) -> None:
        """See `Link`."""
        while not self.report.at_rest:
            self._run(None)

    def stop(self, why: str) -> Report:
        """See `Link`."""
        self._streamer.stop(why)
        self.rest()
        return self.report

    def close(self) -> None:
        """See `Link`."""
        self._streamer.arm.close()
        self._log.close()

    def _run(self, target: Array | None) -> None:
        self._streamer.begin_step(target)
        self.report = self._streamer.report()
        for number in range(TICKS):
            self._streamer.tick(number)


class Paced:
    """A streamer in a process of its own, which outlives the runner until the arm is at rest.

    Raises:
      ConfigError: the arm cannot be connected to.
    """

    paced = True

    def __init__(self, open_arm: Callable[[], Arm], limits: Limits, log: Path) -> None:
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=serve, args=(theirs, open_arm, limits, log), name="streamer")
        with uninterrupted():  # SIGINT before `serve` ignores it would end the process, and `start` may then hang
            self._process.start()
        theirs.close()
        prefer(RUNNER)
        try:
            self.report = self._receive()
        except BaseException:
            self.close()
            raise

    def step(self, target: Array) -> Report:
        """See `Link`."""
        wanted = self.report.step + 1
        self._send((wanted, target))
        while self.report.step < wanted and not self.report.stopped:
            self.report = self._receive()
        return self.report

    def lay(self, objects: Array) -> None:
        """See `Link`."""
        self._send(objects)

    def rest(self) -> None:
        """See `Link`."""
        self._send(None)
        while not self.report.at_rest:
            self.report = self._receive()

    def stop(self, why: str) -> Report:
        """See `Link`."""
        self._send(why)
        while not (self.report.stopped and self.report.at_rest):
            self.report = self._receive()
        return self.report

    def close(self) -> None:
        """See `Link`."""
        prefer(0)
        self._pipe.close()
        self._process.join(OPEN_S)
        self._process.terminate()

    def _send(self, message: tuple[int, Array] | Array | str | None) -> None:
        with suppress(BrokenPipeError):  # _receive says so
            self._pipe.send(message)

    def _receive(self) -> Report:
        try:
            if not self._pipe.poll(OPEN_S):
                raise ConnectionError(f"the streamer has not answered for {OPEN_S:g} s")
            found = self._pipe.recv()
        except (EOFError, ConnectionResetError) as error:
            raise ConnectionError("the streamer has ended") from error
        if isinstance(found, str):
            raise ConfigError(found)
        assert isinstance(found, Report)
        return found


def serve(pipe: Connection, open_arm: Callable[[], Arm], limits: Limits, log: Path) -> None:
    """Run a streamer by the wall clock until the runner closes its end of the `pipe` and the arm is at rest."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the runner's to answer
    prefer(STREAMER)
    try:
        arm = open_arm()
    except (ConfigError, OSError, RuntimeError) as error:
        with suppress(BrokenPipeError):  # the runner has not waited
            pipe.send(f"connection: {' '.join(str(error).split())}")
        return
    with log.open("wb") as file:
        try:
            Server(pipe, Streamer(arm, limits, file)).run()
        finally:
            arm.close()


class Server:
    """The wall clock of a streamer: set-points every PERIOD_S, plans from the pipe, reports to it."""

    def __init__(self, pipe: Connection, streamer: Streamer) -> None:
        self._pipe, self._streamer = pipe, streamer
        self._plan: tuple[int, Array] | None = None
        self._engaged = self._reporting = self._gone = False

    def run(self) -> None:
        """Run until the runner has gone and the arm is at rest."""
        streamer = self._streamer
        self._tell()
        due, slipped = time.monotonic(), 0.0
        while not (self._gone and streamer.report().at_rest):
            self._listen()
            late = self._engaged and (self._plan is None or self._plan[0] <= streamer.step or slipped > SLIP_S)
            target = None if late or self._plan is None else self._plan[1]
            self._plan, slipped = None, 0.0
            streamer.begin_step(target, late)
            self._engaged &= not streamer.stopped
            if self._reporting:
                self._tell()
            for number in range(TICKS):
                due += PERIOD_S
                time.sleep(max(0.0, due - time.monotonic()))
                late_s = time.monotonic() - due
                if late_s > PERIOD_S:  # later ones wait too: a burst would be faster than the rating
                    due, slipped = due + late_s, slipped + late_s
                streamer.tick(number, late_s)

    def _listen(self) -> None:
        """Take what the runner has said since the last control step."""
        try:
            while not self._gone and self._pipe.poll():
                message = self._pipe.recv()
                if isinstance(message, np.ndarray):
                    self._streamer.arm.lay(message)
                    continue
                if isinstance(message, str):
                    self._streamer.stop(message)
                self._engaged, self._reporting = isinstance(message, tuple), True
                self._plan = message if isinstance(message, tuple) else None
        except (EOFError, ConnectionResetError):
            self._gone, self._engaged = True, False
            self._streamer.stop("the runner has gone")

    def _tell(self) -> None:
        report = self._streamer.report()
        if report.at_rest and not self._engaged:
            self._reporting = False
        if not self._gone:
            with suppress(BrokenPipeError):
                self._pipe.send(report)
