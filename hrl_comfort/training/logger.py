"""Rows of metrics.csv, timing.csv, TensorBoard and Weights & Biases."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from torch.utils.tensorboard import SummaryWriter

from hrl_comfort.config import TrainConfig
from hrl_comfort.files.tables import GrowingTable

OUTCOMES = (
    *("success", "return", "steps", "contact", "unsafe_contact", "other_collision"),
    *("shield_share_mean", "protective_stops"),
)
"""Columns of an episode, to which the terms of its reward come: reward/NAME."""
TIMING = ("policy_steps", "seconds", "policy_steps_per_s", "updates_per_s")


class RowLog:
    """Rows of a CSV; each averages the episodes and the updates since the one before.

    Without an episode or an update in that time, their columns are empty, never zero.
    """

    _PLAIN: tuple[str, ...] = ("rows", "episodes", "finished", "updates")
    """Attributes, without their underscore, that an exact continuation needs beside the sums."""

    def __init__(self, path: Path, columns: Sequence[str], outcomes: Sequence[str], terms: Sequence[str]) -> None:
        self.columns, self._outcomes, self._terms = columns, outcomes, terms
        self._table = GrowingTable(path, columns)
        self._sums: dict[str, float] = {}
        self._finished = self._updates = self._episodes = self._rows = 0

    def start(self, steps: int) -> None:
        """Cut the file back to the rows that this log knows of; the training is at `steps`."""
        self._table.begin(self._rows)

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

    def append(self, head: dict[str, Any]) -> dict[str, Any]:
        """Write a row of `head` and the means; return it."""
        row = dict(head)
        for names, count in ((self._outcomes, self._finished), (self._terms, self._updates)):
            if count:
                row |= {name: self._sums[name] / count for name in names if name in self._sums}
        self._table.append([self.cell(row.get(name)) for name in self.columns])
        self._sums.clear()
        self._finished = self._updates = 0
        self._rows += 1
        return row

    def cell(self, value: Any) -> Any:
        """Return what the file holds of a value."""
        return value

    def close(self) -> None:
        """Close what is open: the CSV is only while a row is written."""

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to continue in the middle of a row."""
        return {"sums": dict(self._sums), **{name: getattr(self, f"_{name}") for name in self._PLAIN}}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`; `start` then cuts the files back."""
        for name in self._PLAIN:
            setattr(self, f"_{name}", state[name])
        self._sums = dict(state["sums"])


class OptionsLog(RowLog):
    """Rows of meta_controller_metrics.csv."""

    OUTCOMES = ("success", "placed", "return", "steps")
    """Of an episode: success, objects placed, undiscounted return and control steps."""

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        """Write to `path` rows of a training among the options `names` (K)."""
        self.shares = [f"share/{name}" for name in names]
        """Columns of the options: the share of time that they ran."""
        columns = ("options", "updates", "episodes", *self.OUTCOMES, "exploration", "loss", *self.shares)
        super().__init__(path, columns, self.OUTCOMES, ("loss",))

    def write_row(self, options: int, updates: int, exploration: float, steps: Sequence[int]) -> None:
        """Write a row; its `episodes` are those since the row before, and so are the control `steps` (K) of options."""
        head = {"options": options, "updates": updates, "episodes": self._finished, "exploration": exploration}
        total = sum(steps)
        self.append(head | {name: count / total for name, count in zip(self.shares, steps, strict=True) if total})


class MetricsLog(RowLog):
    """Rows of metrics.csv, timing.csv and the boards."""

    _PLAIN = (*RowLog._PLAIN, "run_id")

    def __init__(
        self, folder: Path, reward_names: tuple[str, ...], terms: tuple[str, ...], config: TrainConfig
    ) -> None:
        self._folder, self._config = folder, config
        outcomes = (*OUTCOMES, *(f"reward/{name}" for name in reward_names))
        columns = ("policy_steps", "stage", "updates", "episodes", "precision_m", *outcomes, *terms)
        super().__init__(folder / "metrics.csv", columns, outcomes, terms)
        self._timing = GrowingTable(folder / "timing.csv", TIMING)
        self._tensorboard: SummaryWriter | None = None
        self._wandb: Any = None
        self._run_id = uuid.uuid4().hex
        """Of Weights & Biases: a resumed training continues its run there."""

    def start(self, steps: int) -> None:
        """Cut the files back to the rows that this log knows of, and open the boards at `steps`."""
        super().start(steps)
        self._timing.begin(self._rows)
        self._tensorboard = SummaryWriter(str(self._folder), purge_step=steps)
        if self._config.logger == "wandb":
            self._wandb = wandb_run(self._folder, self._run_id, asdict(self._config))

    def write_row(
        self, policy_steps: int, stage: str, updates: int, precision_m: float, timing: tuple[float, ...]
    ) -> None:
        """Write a row; `timing` is seconds, policy steps per s and updates per s."""
        head = {"policy_steps": policy_steps, "stage": stage, "updates": updates, "episodes": self._episodes}
        row = self.append({**head, "precision_m": precision_m})
        self._timing.append([policy_steps, *map(self.cell, timing)])
        assert self._tensorboard is not None, "start"
        scalars = {name: value for name, value in row.items() if name not in ("policy_steps", "stage")}
        for name, value in scalars.items():
            self._tensorboard.add_scalar(name, value, policy_steps)
        self._tensorboard.flush()
        if self._wandb is not None:
            self._wandb.log(scalars, step=policy_steps)

    def cell(self, value: Any) -> Any:
        """Return a number with six digits."""
        return f"{value:.6g}" if isinstance(value, float) else value

    def close(self) -> None:
        """Close the boards."""
        if self._tensorboard is not None:
            self._tensorboard.close()
        if self._wandb is not None:
            self._wandb.finish()


def wandb_run(folder: Path, run_id: str, config: dict[str, Any]) -> Any:
    """Return a run of Weights & Biases (extra `wandb`), begun or continued; offline with WANDB_MODE=offline.

    Its files go to `wandb/` in the run folder; `wandb sync` uploads those of an offline run.
    """
    import wandb

    return wandb.init(
        project="hrl-comfort", name=folder.name, dir=str(folder), id=run_id, resume="allow", config=config,
        settings=wandb.Settings(silent=True, console="off"),
    )  # fmt: skip
