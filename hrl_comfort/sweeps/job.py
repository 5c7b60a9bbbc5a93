"""One job of a sweep: it runs, records its outcome and leaves the other jobs alone.

joblib's workers run jobs in processes of their own, and import neither torch nor pandas before they need them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from hydra.core.hydra_config import HydraConfig

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import HIERARCHY, ConfigError, EvaluateConfig, HierarchyTrainConfig, TrainingConfig
from hrl_comfort.config.checks import is_object
from hrl_comfort.config.overrides import override, root_of
from hrl_comfort.files.atomic import overwrites
from hrl_comfort.files.output import EVALUATION_MARKS, INSIST, is_own
from hrl_comfort.files.provenance import RunState, run_state
from hrl_comfort.files.relative_paths import split_prefix
from hrl_comfort.files.run_config import is_same, load_config
from hrl_comfort.files.sweep_record import Job
from hrl_comfort.sweeps.subprocesses import ERRORS, run_in_subprocess
from hrl_comfort.training.preemption import Preempted

Command = Callable[[list[str]], None]
"""Runs a verb with overrides."""
OUTCOMES = {RunState.NEW: "done", RunState.STOPPED: "resumed", RunState.FINISHED: "skipped, finished"}
"""Outcome that a sweep reports of a job that ended well, by its state before."""
LOCAL_LAUNCHERS = ("basic", "joblib")
"""Launchers whose sweep ends when one job gets SIGTERM; the jobs of others are stopped one by one."""


WORKERS = ("joblib", "submitit_local", "ray")
"""Launchers that give up a sweep when one of their processes is killed: jobs run in subprocesses of those."""


class OtherRunError(ConfigError):
    """The folder of a job holds a run of another sweep."""


@dataclass(frozen=True)
class JobResult:
    """Outcome of a job; `float` gives its `score` to a search."""

    status: str
    folder: str = ""
    error: str | None = None
    score: float = math.nan
    """Training: that of its `LearningCurve`. Evaluation: success, 0 to 1."""

    def __float__(self) -> float:
        """Return the score; raise ValueError if there is none."""
        if self.error is not None or math.isnan(self.score):
            raise ValueError(self.error or "no episode has ended, so there is no score")
        return self.score


def job(verb: str, run: Command, command: str, _: object) -> JobResult:
    """Run the unfinished part of a job; return its outcome, failures included."""
    hydra = HydraConfig.get()
    folder = Path(hydra.runtime.output_dir)
    overrides = tuple(str(line) for line in hydra.overrides.task)
    launcher, sweeper = (hydra.runtime.choices[f"hydra/{each}"] for each in ("launcher", "sweeper"))
    in_worker = launcher in WORKERS and hydra.launcher.get("n_jobs") != 1
    words = [*overrides, override("output", folder)]
    record = Job(verb, overrides, "running", command=command)
    try:
        config = compose(root_of(verb), words)
        assert isinstance(config, TrainingConfig | EvaluateConfig)
        state = state_of(config)
        record.write(folder)
        if state is not RunState.FINISHED:
            arguments = [override("resume", folder)] if state is RunState.STOPPED else words
            run_in_subprocess(verb, arguments) if in_worker else run(arguments)
        replace(record, state="done").write(folder)
        return JobResult(OUTCOMES[state], str(folder), score=math.nan if sweeper == "basic" else _score(folder))
    except Preempted as stopped:
        replace(record, state="stopped", why=str(stopped)).write(folder)
        if launcher in LOCAL_LAUNCHERS:
            raise
        return JobResult("stopped", str(folder), str(stopped))
    except Exception as error:  # noqa: BLE001  any failure is reported, and the other jobs continue
        name = "" if isinstance(error, ERRORS) else f"{type(error).__name__}: "
        why = " ".join(f"{name}{error}".split())
        if not isinstance(error, OtherRunError):  # the record in the folder is that of the other run
            replace(record, state="failed", why=why).write(folder)
        return JobResult("failed", str(folder), why)


def state_of(config: TrainingConfig | EvaluateConfig) -> RunState:
    """Return the state of the job that `config` describes, by the content of its output folder.

    An evaluation is finished while its summary is newer than every policy of it. With a policy of Python code it never
    is, for no file tells all that the code depends on.

    Raises:
      OtherRunError: the folder holds another training.
      ConfigError: it is damaged.
    """
    folder, evaluates = Path(config.output), isinstance(config, EvaluateConfig)
    marks = EVALUATION_MARKS if evaluates else ("config.yaml", HIERARCHY)
    known = EvaluateConfig if evaluates else TrainingConfig
    if not (overwrites() or is_own(folder, known, *marks)):
        raise OtherRunError(f"output={folder} holds other files than those of this command; {INSIST}")
    file = folder / (HIERARCHY if isinstance(config, HierarchyTrainConfig) else "config.yaml")
    if not file.is_file():
        return RunState.NEW
    there = load_config(file)
    same = is_same(there, config)
    if isinstance(config, EvaluateConfig):
        return RunState.FINISHED if same and _is_newest(folder / "summary.json", config) else RunState.NEW
    if not same:
        raise OtherRunError(f"output={folder} holds another run; choose another, or delete it")
    return run_state(folder)


def _is_newest(summary: Path, config: EvaluateConfig) -> bool:
    if not summary.is_file():
        return False
    from hrl_comfort.hierarchy.learned import choice_file  # seconds, for torch
    from hrl_comfort.policies.actor import policy_file

    named = {"policy": config.policy, **config.policies}
    paths = {name: split_prefix(source)[1] for name, source in named.items() if source is not None}
    if any(map(is_object, paths.values())):
        return False
    there = {name: Path(path) for name, path in paths.items() if Path(path).exists()}
    files = [choice_file(path) if name == "meta_controller" else policy_file(path) for name, path in there.items()]
    return all(file.stat().st_mtime <= summary.stat().st_mtime for file in files)


def _score(folder: Path) -> float:
    """Return the score of a finished training or evaluation."""
    from hrl_comfort.analysis.learning_curve import curve_of, training_end  # half a second, for pandas
    from hrl_comfort.files.run_folder import read_result

    found = read_result(folder)
    if found.metrics is not None:
        return training_end(found.metrics).get(curve_of(found.metrics).score, math.nan)
    return math.nan if found.episodes is None else float(found.episodes["success"].mean())
