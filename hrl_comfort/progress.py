"""Progress of a training or an evaluation on stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

EVERY_S = 30.0
"""Time between two lines where stderr is no terminal."""
Show = Callable[[int, str], None]
"""(what is done so far, words about it) -> a new state of the line."""


@contextmanager
def progress(what: str, total: int, done: int = 0, thread: bool = True) -> Iterator[Show]:
    """Show how much of `total` is done: a bar in a terminal, else a plain line every EVERY_S.

    A thread draws the bar anew all the time; without one it is drawn when something is done.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _lines(what, total, done)
        return
    text = TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:3.0f}% {task.fields[said]}")
    columns = *text, TextColumn("left"), TimeRemainingColumn()
    bar = Progress(
        *columns, console=console, auto_refresh=thread, refresh_per_second=2, speed_estimate_period=60, transient=True
    )
    with bar:
        line = bar.add_task(what, total=total, completed=done, said="")
        yield lambda now, said: bar.update(line, completed=now, said=said, refresh=not thread)


def _lines(what: str, total: int, done: int) -> Show:
    began = last = time.monotonic()

    def show(now: int, said: str) -> None:
        nonlocal last
        here = time.monotonic()
        if here - last >= EVERY_S and now > done:
            last = here
            left = timedelta(seconds=round((here - began) * (total - now) / (now - done)))
            print(f"{what}: {now} of {total}, {said}, left {left}", file=sys.stderr, flush=True)

    return show


def success_of(outcomes: list[bool]) -> str:
    """Return the share of successes in words."""
    return f"success {sum(outcomes) / len(outcomes):.0%}" if outcomes else "success -"
