"""Trainings and sweeps of the studio: each a process of its own, with its curves and its newest checkpoint."""

from __future__ import annotations

import shlex
import signal
import subprocess
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import ConfigError
from hrl_comfort.files.atomic import write_text
from hrl_comfort.files.tables import read_table

CURVES = 8
"""Most curves of a sweep, those of its first jobs."""
STOP_S = 60.0
"""Time that an interrupted training has to save its state."""


class Training:
    """One training at a time, in folders `training_1`, `training_2`, … under `output`."""

    def __init__(self, output: Path) -> None:
        self._output = output
        self._process: subprocess.Popen[bytes] | None = None
        self._sweep: list[str] = []
        self.folder: Path | None = None
        """Folder of the latest training or sweep."""

    @property
    def running(self) -> bool:
        """Whether the training runs."""
        return self._process is not None and self._process.poll() is None

    def start(self, overrides: Iterable[str], sweep: str = "") -> Path:
        """Start `hrl-comfort train` with `overrides`, as `-m` over the lists of `sweep` if given; return its folder.

        Raises:
          ConfigError: one runs already, or `sweep` has an open quote.
        """
        if self.running:
            raise ConfigError(f"{self.folder} is being trained; stop it first")
        try:
            lists = shlex.split(sweep)
        except ValueError as error:
            raise ConfigError(f"sweep={sweep!r}: {error}") from None
        number = 1
        while (self._output / f"training_{number}").exists():
            number += 1
        self.folder = self._output / f"training_{number}"
        swept = {each.partition("=")[0] for each in lists}
        fixed = [line for line in overrides if line.partition("=")[0] not in swept]
        words = [*fixed, *lists, f"output={self.folder}"]
        self._sweep = ["-m", *words] if lists else []
        self._run(self._sweep or words)
        return self.folder

    def resume(self) -> None:
        """Go on with the latest training.

        Raises:
          ConfigError: it runs, or there is none.
        """
        if self.running or self.folder is None:
            raise ConfigError(f"{self.folder} is being trained" if self.running else "no training was started here")
        self._run(self._sweep or [f"resume={self.folder}"])  # a sweep given again goes on

    def stop(self) -> None:
        """Interrupt the training, which saves its state, and wait for it."""
        if self._process is not None and self.running:
            self._process.send_signal(signal.SIGINT)
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(STOP_S)
            if self.running:
                self._process.kill()

    def newest(self) -> str:
        """Return the policy of the latest training's newest checkpoint.

        Raises:
          ConfigError: there is none yet.
        """
        policies = [*self.folder.rglob("policy.pt")] if self.folder else []
        if not policies:
            raise ConfigError("there is no checkpoint yet; agent.checkpoint_every says how often one is written")
        return str(max(policies, key=lambda each: each.stat().st_mtime))

    def status(self) -> str:
        """Return a line about the latest training; the last line of its log where it failed."""
        if self._process is None or self.folder is None:
            return "no training yet"
        if self.running:
            return f"{self.folder} is being trained"
        if self._process.returncode == 0:
            return f"{self.folder} is trained"
        said = self._log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return f"{self.folder} has stopped: {said[-1] if said else self._process.returncode}"

    def curves(self) -> tuple[NDArray[np.float64], ...]:
        """Return policy steps (T,) and success (T,) of the first CURVES jobs, NaN where there is none; T may be 0."""
        found: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
        for folder in self._jobs[:CURVES]:
            at = success = np.full(1, np.nan)
            with suppress(ConfigError):
                table = read_table(folder / "metrics.csv")
                known = None if table is None else table.reindex(columns=["policy_steps", "success"]).dropna()
                if known is not None and len(known):
                    at, success = known["policy_steps"].to_numpy(float), known["success"].to_numpy(float)
            found.append((at, success))
        steps = np.unique(np.concatenate([np.zeros(0), *(at[np.isfinite(at)] for at, _ in found)]))
        curves = [np.interp(steps, at, success, np.nan, np.nan) for at, success in found]
        return steps, *curves, *[np.full_like(steps, np.nan)] * (CURVES - len(curves))

    @property
    def _jobs(self) -> list[Path]:
        """The folders of the latest sweep's jobs, by their numbers; of a single training its own."""
        if self.folder is None:
            return []
        jobs = [each for each in self.folder.glob("*") if each.name.isdecimal()]
        return sorted(jobs, key=lambda each: int(each.name)) or [self.folder]

    @property
    def _log(self) -> Path:
        assert self.folder is not None
        return self._output / f"{self.folder.name}.log"

    def _run(self, words: list[str]) -> None:
        write_text(self._log, "")
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "hrl_comfort", "train", *words],
                stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True,
            )  # fmt: skip
