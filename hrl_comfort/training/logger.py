"""Rows of metrics.csv, timing.csv, TensorBoard and Weights & Biases."""

from __future__ import annotations

import uuid
from dataclasses import asdict
from pathlib import Path
from typing import Any

from torch.utils.tensorboard import SummaryWriter

from hrl_comfort.agents.sac import TERMS
from hrl_comfort.config import TrainConfig
from hrl_comfort.files.tables import GrowingTable
from hrl_comfort.training.collector import OUTCOMES
from hrl_comfort.training.wandb_board import WandbBoard

TIMING = ("policy_steps", "seconds", "policy_steps_per_s", "updates_per_s")


class MetricsLog:
    """Rows of metrics.csv, timing.csv and the boards; each averages over the time since the one before.

    Without an episode or an update in that time, their columns are empty, never zero.
    """

    _PLAIN = ("run_id", "rows", "episodes", "finished", "updates")
    """Attributes, without their underscore, that an exact continuation needs beside the sums."""

    def __init__(self, folder: Path, reward_names: tuple[str, ...], config: TrainConfig) -> None:
        self._folder, self._config = folder, config
        self._outcomes = (*OUTCOMES, *(f"reward/{name}" for name in reward_names))
        self.columns = ("policy_steps", "stage", "updates", "episodes", "precision_m", *self._outcomes, *TERMS)
        self._metrics = GrowingTable(folder / "metrics.csv", self.columns)
        self._timing = GrowingTable(folder / "timing.csv", TIMING)
        self._sums: dict[str, float] = {}
        self._finished = self._updates = self._episodes = self._rows = 0
        self._boards: list[SummaryWriter | WandbBoard] = []
        self._run_id = uuid.uuid4().hex
        """Of Weights & Biases: a resumed training continues its run there."""

    def start(self, policy_steps: int) -> None:
        """Cut the files back to the rows that this log knows of, and open the boards at `policy_steps`."""
        self._metrics.begin(self._rows)
        self._timing.begin(self._rows)
        self._boards = [SummaryWriter(str(self._folder), purge_step=policy_steps)]
        if self._config.logger == "wandb":
            self._boards.append(WandbBoard(self._folder, self._run_id, asdict(self._config)))

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
        self._metrics.append([stage if name == "stage" else _shown(row.get(name)) for name in self.columns])
        self._timing.append([policy_steps, *map(_shown, timing)])
        for board in self._boards:
            for name, value in row.items():
                if name != "policy_steps":
                    board.add_scalar(name, value, policy_steps)
            board.flush()
        self._sums.clear()
        self._finished = self._updates = 0
        self._rows += 1

    def close(self) -> None:
        """Close the boards."""
        for board in self._boards:
            board.close()

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to continue in the middle of a row."""
        return {"sums": dict(self._sums), **{name: getattr(self, f"_{name}") for name in self._PLAIN}}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`; `start` then cuts the files back."""
        for name in self._PLAIN:
            setattr(self, f"_{name}", state[name])
        self._sums = dict(state["sums"])


def _shown(value: float | None) -> float | str | None:
    return f"{value:.6g}" if isinstance(value, float) else value
