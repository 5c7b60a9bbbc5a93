"""Runs of the command in a subprocess, for the jobs of a sweep.

joblib, submitit and Ray give up a sweep if one of their workers is killed, for example for want of memory. A worker
therefore runs each job in a subprocess and waits; a killed job leaves the others alone.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from functools import partial
from types import FrameType

from hrl_comfort.config import ConfigError
from hrl_comfort.training.preemption import Preempted, end_with_parent

COMMAND = (sys.executable, "-P", "-m", "hrl_comfort")
"""The command; `-P` keeps the working directory off the module path."""
PREFIX = "hrl-comfort: "


class KilledError(Exception):
    """A subprocess was killed by a signal."""


ERRORS = (ConfigError, FloatingPointError, KilledError, MemoryError, OSError)
"""Errors that are reported by their message alone."""


def run_in_subprocess(verb: str, words: list[str]) -> None:
    """Run `hrl-comfort verb words` in a subprocess, which gets this process's SIGTERM and ends with it.

    Raises:
      ConfigError: it failed; the message is its last line.
      KilledError: it was killed by a signal.
      Preempted: it stopped after SIGTERM.
    """
    last, asked = "", False
    children: list[subprocess.Popen[str]] = []

    def forward(number: int, _: FrameType | None) -> None:
        nonlocal asked
        asked = True
        for child in children:
            child.send_signal(number)

    paths = os.pathsep.join(path or os.getcwd() for path in sys.path)
    before = signal.signal(signal.SIGTERM, forward)
    try:
        with subprocess.Popen(
            [*COMMAND, *verb.split(), *words],
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": paths},
            preexec_fn=partial(end_with_parent, os.getpid()),
        ) as child:
            children.append(child)
            if asked:  # during the start
                child.send_signal(signal.SIGTERM)
            assert child.stderr is not None
            for line in child.stderr:
                print(line, end="", file=sys.stderr)
                last = line.strip() or last
            code = child.wait()
    finally:
        signal.signal(signal.SIGTERM, before)
    why = last.removeprefix(PREFIX)
    if code == 128 + signal.SIGTERM or (asked and code == -signal.SIGTERM):
        raise Preempted(why or "stopped by SIGTERM")
    if code < 0:
        memory = ", perhaps for want of memory" if code == -signal.SIGKILL else ""
        raise KilledError(f"its process was ended by {signal.Signals(-code).name}{memory}")
    if code:
        raise ConfigError(why or f"exit code {code}")
