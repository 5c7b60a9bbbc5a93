"""Processes of one's own, which run the same code, and the jobs of a sweep in them.

A job that is killed, out of memory say, takes no other along: joblib gives up a whole sweep when one of its
processes is killed, so these only start the job and wait.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from types import FrameType

from hrl_comfort.config import ConfigError
from hrl_comfort.training.preemption import Preempted

PYTHON = (sys.executable, "-P", "-m")
"""Runs a module, wherever the command was given: `-P` keeps the modules that lie there out."""
COMMAND = (*PYTHON, "hrl_comfort")
PREFIX = "hrl-comfort: "


class KilledError(Exception):
    """A process of one's own was killed, or is over before its time."""


def same_paths() -> dict[str, str]:
    """Return the variables under which another Python finds the modules that this one does."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)}


def ended_by(code: int) -> str:
    """Return what ended a process with this exit code, negative if it was a signal."""
    if code >= 0:
        return f"has ended, with exit code {code}"
    memory = ", perhaps for want of memory" if code == -signal.SIGKILL else ""
    return f"was ended by {signal.Signals(-code).name}{memory}"


def run_apart(verb: str, words: list[str]) -> None:
    """Run `hrl-comfort verb words` in a process of its own; SIGTERM is passed on to it.

    Raises:
      ConfigError: it failed; what it said last.
      KilledError: it was killed.
      Preempted: it was told to stop, and has.
    """
    last, told = "", False
    children: list[subprocess.Popen[str]] = []

    def pass_on(number: int, _: FrameType | None) -> None:
        nonlocal told
        told = True
        for each in children:
            each.send_signal(number)

    before = signal.signal(signal.SIGTERM, pass_on)
    try:
        command = [*COMMAND, *verb.split(), *words]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=same_paths()) as child:
            children.append(child)
            if told:  # while it was being started
                child.send_signal(signal.SIGTERM)
            assert child.stderr is not None
            for line in child.stderr:
                print(line, end="", file=sys.stderr)
                last = line.strip() or last
            code = child.wait()
    finally:
        signal.signal(signal.SIGTERM, before)
    why = last.removeprefix(PREFIX)
    if code == 128 + signal.SIGTERM or (told and code == -signal.SIGTERM):
        raise Preempted(why or "stopped by SIGTERM")
    if code < 0:
        raise KilledError(f"its process {ended_by(code)}")
    if code:
        raise ConfigError(why or f"exit code {code}")
