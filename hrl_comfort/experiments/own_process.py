"""A job of a sweep in a process of its own: one that is killed, out of memory say, takes no other along.

Joblib gives up a whole sweep when one of its processes is killed; so these only start the job and wait.
"""

from __future__ import annotations

import signal
import subprocess
import sys
from types import FrameType

from hrl_comfort.config import ConfigError
from hrl_comfort.experiments.preemption import Preempted

COMMAND = (sys.executable, "-m", "hrl_comfort")
PREFIX = "hrl-comfort: "


class JobKilledError(RuntimeError):
    """The process of a job was killed."""


def run_apart(verb: str, words: list[str]) -> None:
    """Run `hrl-comfort verb words` in a process of its own; SIGTERM is passed on to it.

    Raises:
      ConfigError: it failed; what it said last.
      JobKilledError: it was killed.
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
        with subprocess.Popen([*COMMAND, verb, *words], stderr=subprocess.PIPE, text=True) as child:
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
        memory = ", perhaps for want of memory" if code == -signal.SIGKILL else ""
        raise JobKilledError(f"its process was ended by {signal.Signals(-code).name}{memory}")
    if code:
        raise ConfigError(why or f"exit code {code}")
