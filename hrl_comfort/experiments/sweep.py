"""`hrl-comfort VERB -m`: every combination of the swept overrides, each in a folder of its own."""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from unittest.mock import patch

from hydra import version
from hydra._internal.hydra import Hydra
from hydra._internal.utils import create_config_search_path
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import JobReturn, JobStatus, filter_overrides
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf.errors import OmegaConfBaseException

from hrl_comfort.compose import compose, config_dir, one_line, override
from hrl_comfort.config import ConfigError, EvaluateConfig, TrainConfig
from hrl_comfort.experiments.again import Left, OtherRunError, left
from hrl_comfort.experiments.own_process import JobKilledError, run_apart
from hrl_comfort.experiments.preemption import Preempted
from hrl_comfort.experiments.run_folder import read_run
from hrl_comfort.experiments.statistics import column
from hrl_comfort.experiments.sweep_record import Job, find_jobs, planned
from hrl_comfort.experiments.training_end import training_end

Run = Callable[[list[str]], None]
"""What runs a verb with its overrides."""
ERRORS = (ConfigError, FloatingPointError, JobKilledError, OSError)
"""Failures whose message says it all; of others the class is named too."""
EXTRAS = {
    "submitit_local": ("submitit", "hydra_plugins.hydra_submitit_launcher"),
    "submitit_slurm": ("submitit", "hydra_plugins.hydra_submitit_launcher"),
    "ray": ("ray", "hydra_plugins.hydra_ray_launcher"),
    "optuna": ("optuna", "hydra_plugins.hydra_optuna_sweeper"),
}
"""Launchers and sweepers that need an extra: its name, and the module that it brings."""
TOGETHER = ("basic", "joblib")
"""Launchers whose jobs are told to stop together: one that is told ends the sweep."""


@dataclass(frozen=True)
class Ended:
    """How a job ended; as a number, for a sweeper that searches, its success."""

    what: str
    folder: str = ""
    problem: str | None = None
    success: float = math.nan

    def __float__(self) -> float:
        """Return the success, 0 to 1; raise ValueError where there is none."""
        if self.problem is not None or math.isnan(self.success):
            raise ValueError(self.problem or "no episode tells of success")
        return self.success


def multirun(verb: str, run: Run, checked: list[str], outputs: list[str]) -> None:
    """Run `verb` once for every combination of the swept overrides, in parallel, each in its own folder.

    `checked` is what `compose.check_overrides` returns, `outputs` what `output=` says.

    Raises:
      ConfigError: a choice is not allowed, or jobs are not done; the others have gone on.
    """
    rest = [*checked, *(line for each in outputs for line in _folders(each))]
    rest += _of_plugins(rest)
    version.setbase("1.3")
    hydra_app = Hydra.create_main_hydra2("hrl-comfort", create_config_search_path(str(config_dir())))
    command, batches, broke = uuid.uuid4().hex, None, ""
    try:
        asked = hydra_app.compose_config(verb, rest, RunMode.MULTIRUN, with_log_configuration=False)
        folder = Path(asked.hydra.sweep.dir)
        rest.append(override("hydra.sweep.dir", folder))  # it may hold the time, which goes on
        with _every_job_waited_for(rest):
            batches = hydra_app.multirun(
                verb, partial(job, verb, run, command), rest, with_log_configuration=False
            )
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(one_line(error)) from error
    except ERRORS:
        raise
    except Exception as error:  # noqa: BLE001  of a launcher or sweeper, whose classes only its extra knows
        broke = f"{type(error).__name__}: {' '.join(str(error).split())}"
    finally:
        GlobalHydra.instance().clear()
    if batches is None:
        _say_from_records(folder, command, broke)
    else:
        _say([each for batch in batches for each in batch])


def _say(jobs: list[JobReturn]) -> None:
    """Print how each job ended; raise ConfigError if one is not done."""
    not_done = 0
    for each in jobs:
        ended: Ended = each.return_value
        not_done += ended.problem is not None
        print(f"{ended.what}: {' '.join(each.overrides or ())}: {ended.problem or ended.folder}")
    if not_done:
        raise ConfigError(f"{not_done} of {len(jobs)} jobs failed")


def _say_from_records(folder: Path, command: str, broke: str) -> None:
    """Print how the jobs stand where the sweeper returned nothing: Optuna's, or one that an error ended."""
    jobs = {where: each for where, each in find_jobs(folder).items() if each.command == command}
    for where, each in jobs.items():
        print(f"{each.state}: {' '.join(each.overrides)}: {each.why or where}")
    begun = {each.overrides for each in jobs.values()}
    waiting = [each for each in planned(folder) if each not in begun] if broke else []
    for overrides in waiting:
        print(f"not begun: {' '.join(overrides)}")
    not_done = sum(each.state != "done" for each in jobs.values()) + len(waiting)
    if broke:
        raise ConfigError(
            f"{not_done} of {len(jobs) + len(waiting)} jobs are not done ({broke}); "
            "the same command again does what is left"
        )
    if not_done:
        raise ConfigError(f"{not_done} of {len(jobs)} jobs failed")


def _of_plugins(overrides: list[str]) -> list[str]:
    """Return what the chosen sweeper has to be told besides; raise ConfigError where an extra is missing."""
    chosen = dict(line.split("=", 1) for line in overrides if line.startswith("hydra/"))
    for key in ("hydra/launcher", "hydra/sweeper"):
        extra, module = EXTRAS.get(chosen.get(key, ""), ("", ""))
        if extra and find_spec(module) is None:
            what = f"{key}={chosen[key]}"
            raise ConfigError(f"{what} needs the extra {extra}: pip install 'hrl-comfort[{extra}]'")
    if chosen.get("hydra/sweeper") != "optuna":
        return []
    wanted = {"hydra.sweeper.direction": "maximize"}
    if chosen.get("hydra/sweeper/sampler") != "grid":  # which draws nothing
        wanted["hydra.sweeper.sampler.seed"] = "0"  # so that the same command asks for the same trials
    return [
        f"{key}={value}"
        for key, value in wanted.items()
        if not any(line.startswith(f"{key}=") for line in overrides)
    ]


def _folders(output: str) -> list[str]:
    """Return what tells Hydra where the jobs write: in `output`, numbered, unless it says `${...}` itself."""
    output = output.strip("'\"")
    head, sign, tail = output.partition("${")
    if not sign:
        return [f"hydra.sweep.dir='{output}'"]
    above, _, name = head.rpartition("/")
    return [f"hydra.sweep.dir='{above or '.'}'", f"hydra.sweep.subdir='{name}{sign}{tail}'"]


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
        config = compose(verb, words)
        assert isinstance(config, TrainConfig | EvaluateConfig)
        rest = left(config)
        record.write(folder)
        if rest is not Left.NOTHING:
            what = [override("resume", folder)] if rest is Left.REST else words
            run_apart(verb, what) if shared else run(what)
        replace(record, state="done").write(folder)
        return Ended(rest.value, str(folder), success=math.nan if sweeper == "basic" else _success(folder))
    except Preempted as stopped:
        replace(record, state="stopped", why=str(stopped)).write(folder)
        if launcher in TOGETHER:
            raise
        return Ended("stopped", str(folder), str(stopped))
    except Exception as error:  # noqa: BLE001  whatever it was, it is reported and the other jobs go on
        kind = "" if isinstance(error, ERRORS) else f"{type(error).__name__}: "
        why = " ".join(f"{kind}{error}".split())
        if not isinstance(error, OtherRunError):  # its record is that run's
            replace(record, state="failed", why=why).write(folder)
        return Ended("failed", str(folder), why)


def _success(folder: Path) -> float:
    """Return the success of a finished job, 0 to 1: at the end of a training, or of an evaluation."""
    found = read_run(folder)
    if found.metrics is not None:
        return training_end(found.metrics).get("success", math.nan)
    return float(column(found.episodes or [], "success").mean()) if found.episodes else math.nan


@contextmanager
def _every_job_waited_for(overrides: list[str]) -> Iterator[None]:
    """Let submitit's launchers wait for all jobs where one was killed; they would leave at the first."""
    if not any(line.startswith("hydra/launcher=submitit") for line in overrides):
        yield
        return
    import submitit

    results = submitit.Job.results

    def of(each: submitit.Job[JobReturn]) -> list[JobReturn]:
        try:
            return results(each)
        except (submitit.core.utils.UncompletedJobError, submitit.core.utils.FailedJobError):
            why = f"{each.state} without a result; see {each.paths.stderr}"
            overrides = filter_overrides(each.submission().args[0])
            lost = JobReturn(overrides=overrides, status=JobStatus.COMPLETED)
            lost.return_value = Ended("failed", problem=why)
            return [lost]

    with patch.object(submitit.Job, "results", of):
        yield
