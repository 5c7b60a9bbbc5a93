"""Calls that run at a time, each in a process of its own."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import TypeVar

from hrl_comfort.sim.processes.child import with_trace
from hrl_comfort.training.preemption import Preempted, asked_to_stop, end_with_parent

C = TypeVar("C")
POLL_S = 0.5
"""Time between two looks at whether SIGTERM has come."""


def run_each(call: Callable[[C], object], arguments: Sequence[C], jobs: int) -> None:
    """Do `call` with each of `arguments`: `jobs` at a time in new processes, or here one after another if that is 1.

    Call and arguments are pickled. The processes end with this one; those that run when SIGTERM comes, or when another
    fails, get SIGTERM.

    Raises:
      Preempted: SIGTERM has come.
      Exception: the first that a call raised, or RuntimeError if a process was killed.
    """
    if min(jobs, len(arguments)) <= 1:
        for argument in arguments:
            call(argument)
        return
    waiting, running, stopped = list(arguments), dict[Connection, BaseProcess](), set[int | None]()
    failed: list[BaseException] = []
    with asked_to_stop() as stop:
        try:
            while running or (waiting and not failed and not stop()):
                while waiting and len(running) < jobs and not failed and not stop():
                    here, process = _started(call, waiting.pop(0))
                    running[here] = process
                heard = wait(list(running), POLL_S)
                for here in [each for each in running if each in heard]:
                    failed += _ended(here, running.pop(here))
                if failed or stop():
                    _terminate(running, stopped)
        finally:
            _terminate(running, stopped)
            for process in running.values():
                process.join()
        if stop() and all(isinstance(each, Preempted) for each in failed):
            raise Preempted("stopped by SIGTERM")
    if failed:
        raise failed[0]


def _terminate(running: dict[Connection, BaseProcess], stopped: set[int | None]) -> None:
    """Send SIGTERM to processes, once to each: a second would cut short how a training ends."""
    for process in running.values():
        if process.pid not in stopped:
            stopped.add(process.pid)
            process.terminate()


def _started(call: Callable[[C], object], argument: C) -> tuple[Connection, BaseProcess]:
    """Return what hears of a call, and the process that does it."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_told, args=(os.getpid(), there, call, argument))
    process.start()
    there.close()
    return here, process


def _ended(here: Connection, process: BaseProcess) -> list[BaseException]:
    """Return what the call of a process raised, if it did; wait for its end."""
    try:
        raised = here.recv()
    except EOFError:
        process.join()
        if process.exitcode == -signal.SIGTERM:  # before it could hear of it
            raised = [Preempted("stopped by SIGTERM")]
        else:
            raised = [RuntimeError(f"a process ended with exit code {process.exitcode}")]
    process.join()
    here.close()
    return raised


def _told(parent: int, there: Connection, call: Callable[[C], object], argument: C) -> None:
    """Do a call in this process; tell its `parent` what it raises."""
    end_with_parent(parent)
    raised = list[BaseException]()
    try:
        call(argument)
    except BaseException as error:  # noqa: BLE001
        raised.append(with_trace(error))
    there.send(raised)
