"""Progress line of a training."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

Show = Callable[[int, Sequence[bool], float, str], None]
"""(policy steps, success of the latest episodes, precision in m, stage) -> the line."""


@contextmanager
def training_line(task: str, total: int, done: int) -> Iterator[Show]:
    """Show a line with the task and stage, the success so far, the precision and the time left."""
    columns = (
        TextColumn("{task.description}{task.fields[stage]}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f}%"),
        TextColumn("success {task.fields[success]}"),
        TextColumn("precision {task.fields[precision]}"),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, refresh_per_second=2, speed_estimate_period=60) as progress:
        line = progress.add_task(f"train {task}", total=total, completed=done, success="-", precision="-", stage="")

        def show(policy_steps: int, outcomes: Sequence[bool], precision_m: float, stage: str) -> None:
            success = f"{sum(outcomes) / len(outcomes):4.0%}" if outcomes else "-"
            progress.update(
                line,
                completed=policy_steps,
                success=success,
                precision=f"{precision_m:.3g} m",
                stage=f" ({stage})" if stage else "",
            )

        yield show
