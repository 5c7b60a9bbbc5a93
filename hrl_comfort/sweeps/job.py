"""One job of a sweep: it is run, what it came to is noted, and the others go on."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig

from hrl_comfort.analysis.intervals import column
from hrl_comfort.analysis.job_status import Left, OtherRunError, left
from hrl_comfort.analysis.learning_curve import curve_of
from hrl_comfort.analysis.training_end import training_end
from hrl_comfort.config import ConfigError, EvaluateConfig, MetaControllerTrainConfig, TrainConfig
from hrl_comfort.config.compose import compose
from hrl_comfort.config.overrides import override, root_of
from hrl_comfort.files.run_folder import read_run
from hrl_comfort.files.sweep_record import Job
from hrl_comfort.sweeps.subprocesses import KilledError, run_apart
from hrl_comfort.training.preemption import Preempted

Run = Callable[[list[str]], None]
"""What runs a verb with its overrides."""
ERRORS = (ConfigError, FloatingPointError, KilledError, OSError)
"""Failures whose message says it all; of others the class is named too."""
TOLD_TOGETHER = ("basic", "joblib")
"""Launchers whose jobs are told to stop together: one that is told ends the sweep."""


@dataclass(frozen=True)
class Ended:
    """How a job ended; as a number, for a sweeper that searches, its `score`."""

    what: str
    folder: str = ""
    problem: str | None = None
    score: float = math.nan
    """Of a training that of its `LearningCurve`, of an evaluation success, 0 to 1."""

    def __float__(self) -> float:
        """Return the score; raise ValueError where there is none."""
        if self.problem is not None or math.isnan(self.score):
            raise ValueError(self.problem or "no episode has ended, so there is no score")
        return self.score


def job(verb: str, run: Run, command: str, _: object) -> Ended:
    """Run what is left of one job of a sweep; return what was done, or what stopped it: the others go on."""
    hydra = HydraConfig.get()
    folder = Path(hydra.runtime.output_dir)
    overrides = tuple(str(line) for line in hydra.overrides.task)
    launcher, sweeper = (hydra.runtime.choices[f"hydra/{each}"] for each in ("launcher", "sweeper"))
    shared = launcher == "joblib" and hydra.launcher.n_jobs != 1  # its processes serve several jobs
    words = [*overrides, override("output", folder)]
    record = Job(verb, overrides, "running", command=command)
    GlobalHydra.instance().clear()  # the job composes for itself, as a single run does
    try:
        config = compose(root_of(verb), words)
        assert isinstance(config, TrainConfig | MetaControllerTrainConfig | EvaluateConfig)
        rest = left(config)
        record.write(folder)
        if rest is not Left.NOTHING:
            what = [override("resume", folder)] if rest is Left.REST else words
            run_apart(verb, what) if shared else run(what)
        replace(record, state="done").write(folder)
        return Ended(rest.value, str(folder), score=math.nan if sweeper == "basic" else _score(folder))
    except Preempted as stopped:
        replace(record, state="stopped", why=str(stopped)).write(folder)
        if launcher in TOLD_TOGETHER:
            raise
        return Ended("stopped", str(folder), str(stopped))
    except Exception as error:  # noqa: BLE001  whatever it was, it is reported and the other jobs go on
        return failed(record, folder, error)


def failed(record: Job, folder: Path, error: Exception) -> Ended:
    """Note in its record, and return, what a job failed of."""
    kind = "" if isinstance(error, ERRORS) else f"{type(error).__name__}: "
    why = " ".join(f"{kind}{error}".split())
    if not isinstance(error, OtherRunError):  # its record is that run's
        replace(record, state="failed", why=why).write(folder)
    return Ended("failed", str(folder), why)


def _score(folder: Path) -> float:
    """Return the score of a finished job: at the end of a training, or of an evaluation."""
    found = read_run(folder)
    if found.metrics is not None:
        return training_end(found.metrics).get(curve_of(found.metrics).score, math.nan)
    return float(column(found.episodes or [], "success").mean()) if found.episodes else math.nan
