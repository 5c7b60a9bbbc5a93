"""Files of a training: the lock on its folder, and the rows of metrics.csv."""

from __future__ import annotations

import csv
import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from torch.utils.tensorboard import SummaryWriter

from hrl_comfort.agents import checkpoint
from hrl_comfort.agents.sac import TERMS
from hrl_comfort.config import ConfigError
from hrl_comfort.files.atomic import write_text
from hrl_comfort.files.provenance import read_provenance

OUTCOMES = ("success", "return", "steps", "human_collision", "other_collision")
TIMING = ("policy_steps", "seconds", "policy_steps_per_s", "updates_per_s")


@contextmanager
def claim(folder: Path, resume: bool) -> Iterator[None]:
    """Hold `folder` for one training, as long as the context lasts (the process's end frees it too).

    Raises:
        ConfigError: another process trains in it, or it holds a run and `resume` is false. A training that
            ended before its first checkpoint has left nothing to resume, and its folder is free.
    """
    if resume and not folder.is_dir():
        raise ConfigError(f"resume={folder} is not a run folder")
    folder.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError(f"{folder} is in use by another training; choose another output") from None
        if not resume and _begun(folder):
            if (folder / "meta_controller.pt").exists() and not checkpoint.resumable(folder / "checkpoints"):
                raise ConfigError(f"output={folder} already holds a controller; choose another")
            raise ConfigError(f"output={folder} already holds a run; choose another, or say resume={folder}")
        yield
    finally:
        os.close(descriptor)


def _begun(folder: Path) -> bool:
    """Return whether a run is there that is finished, or can be resumed."""
    if checkpoint.resumable(folder / "checkpoints"):
        return True
    if (folder / "provenance.json").exists():
        return read_provenance(folder).finished
    return any((folder / name).exists() for name in ("policy.pt", "meta_controller.pt"))


class MetricsLog:
    """Rows of metrics.csv, timing.csv and TensorBoard; each averages over the time since the one before.

    Without an episode or an update in that time, their columns are empty, never zero.
    """

    def __init__(self, folder: Path, reward_names: tuple[str, ...]) -> None:
        self._folder = folder
        self._outcomes = (*OUTCOMES, *(f"reward/{name}" for name in reward_names))
        self.columns = ("policy_steps", "stage", "updates", "episodes", "precision_m", *self._outcomes, *TERMS)
        self._sums: dict[str, float] = {}
        self._finished = self._updates = self._episodes = self._rows = 0
        self._board: SummaryWriter | None = None

    def start(self, policy_steps: int) -> None:
        """Cut the files back to the rows that this log knows of, and open TensorBoard at `policy_steps`."""
        for name, columns in (("metrics.csv", self.columns), ("timing.csv", TIMING)):
            path = self._folder / name
            lines = path.read_text().splitlines(keepends=True)[1 : self._rows + 1] if self._rows else []
            write_text(path, "".join([",".join(columns) + "\n", *lines]))
        self._board = SummaryWriter(str(self._folder), purge_step=policy_steps)

    def episode(self, outcome: dict[str, float]) -> None:
        """Count one finished episode."""
        self._finished += 1
        self._episodes += 1
        self._add(outcome)

    def update(self, terms: dict[str, float]) -> None:
        """Count one update."""
        self._updates += 1
        self._add(terms)

    def _add(self, values: dict[str, float]) -> None:
        for name, value in values.items():
            self._sums[name] = self._sums.get(name, 0.0) + value

    def write_row(
        self, policy_steps: int, stage: str, updates: int, precision_m: float, timing: tuple[float, ...]
    ) -> None:
        """Write a row; `timing` is seconds, policy steps per s and updates per s."""
        row: dict[str, float] = {
            "policy_steps": policy_steps,
            "updates": updates,
            "episodes": self._episodes,
            "precision_m": precision_m,
        }
        for names, count in ((self._outcomes, self._finished), (TERMS, self._updates)):
            if count:
                row |= {name: self._sums[name] / count for name in names}
        self._append("metrics.csv", [stage if name == "stage" else row.get(name) for name in self.columns])
        self._append("timing.csv", [policy_steps, *timing])
        assert self._board is not None
        for name, value in row.items():
            if name != "policy_steps":
                self._board.add_scalar(name, value, policy_steps)
        self._board.flush()
        self._sums.clear()
        self._finished = self._updates = 0
        self._rows += 1

    def _append(self, name: str, values: list[float | str | None]) -> None:
        cells = ["" if v is None else f"{v:.6g}" if isinstance(v, float) else v for v in values]
        with (self._folder / name).open("a", newline="") as file:
            csv.writer(file, lineterminator="\n").writerow(cells)

    def close(self) -> None:
        """Close TensorBoard's file."""
        if self._board is not None:
            self._board.close()

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to continue in the middle of a row."""
        return {
            "rows": self._rows,
            "episodes": self._episodes,
            "finished": self._finished,
            "updates": self._updates,
            "sums": dict(self._sums),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`; `start` then cuts the files back."""
        self._rows, self._episodes = state["rows"], state["episodes"]
        self._finished, self._updates = state["finished"], state["updates"]
        self._sums = dict(state["sums"])
