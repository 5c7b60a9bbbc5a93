"""Curves of a training on Weights & Biases (extra `wandb`): those that TensorBoard gets."""

from __future__ import annotations

from pathlib import Path
from typing import Any


class WandbBoard:
    """A run of Weights & Biases, with the methods of TensorBoard's writer; offline with WANDB_MODE=offline.

    Its files go to `wandb/` in the run folder; `wandb sync` uploads those of an offline run.
    """

    def __init__(self, folder: Path, run_id: str, config: dict[str, Any]) -> None:
        import wandb

        settings = wandb.Settings(silent=True, console="off")
        self._run = wandb.init(
            project="hrl-comfort", name=folder.name, dir=str(folder), id=run_id, resume="allow", config=config,
            settings=settings,
        )  # fmt: skip
        self._row: dict[str, float] = {}
        self._step = 0

    def add_scalar(self, name: str, value: float, step: int) -> None:
        """Add a value to the row of `step`."""
        self._row[name], self._step = value, step

    def flush(self) -> None:
        """Send the row."""
        self._run.log(self._row, step=self._step)
        self._row = {}

    def close(self) -> None:
        """End the run."""
        self._run.finish()
