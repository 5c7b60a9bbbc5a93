"""A sweep gets as far as it can: who fails, is killed or told to stop is reported, and the others go on."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from hydra._internal.hydra import Hydra

from hrl_comfort import __main__ as commands
from hrl_comfort.config import ConfigError
from hrl_comfort.files.sweep_record import find_jobs
from hrl_comfort.sweeps import job as sweep_job
from hrl_comfort.sweeps import launcher as sweep
from hrl_comfort.sweeps import subprocesses as own_process
from hrl_comfort.sweeps.job import Ended
from hrl_comfort.sweeps.subprocesses import KilledError, run_apart
from hrl_comfort.training.preemption import Preempted

Script = Callable[[str], None]


@pytest.fixture
def says(monkeypatch: pytest.MonkeyPatch) -> Script:
    """Let a script stand for the command."""

    def stand_in(script: str) -> None:
        monkeypatch.setattr(own_process, "COMMAND", (sys.executable, "-c", script))

    return stand_in


def test_a_job_that_is_told_to_stop_before_it_can_say_so_has_stopped(says: Script) -> None:
    says("import time; time.sleep(60)")  # as while it imports
    alarm = threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGTERM))
    alarm.start()
    with pytest.raises(Preempted, match="stopped by SIGTERM"):
        run_apart("train", [])
    alarm.join()


def test_a_job_in_its_own_process_tells_what_went_wrong(says: Script) -> None:
    says("import sys; print('warning', file=sys.stderr); sys.exit('hrl-comfort: no such policy')")
    with pytest.raises(ConfigError, match=r"^no such policy$"):
        run_apart("train", [])
    says("import os; os.kill(os.getpid(), 9)")
    with pytest.raises(KilledError, match="ended by SIGKILL, perhaps for want of memory"):
        run_apart("train", [])
    says("import sys; print('hrl-comfort: go on with resume=a', file=sys.stderr); sys.exit(143)")
    with pytest.raises(Preempted, match=r"^go on with resume=a$"):
        run_apart("train", [])
    says("")
    run_apart("train", [])


def test_a_job_in_its_own_process_is_told_to_stop_too(says: Script) -> None:
    says(
        "import signal, sys, time\n"
        "signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))\n"
        "print('ready', file=sys.stderr, flush=True); time.sleep(30)"
    )
    threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGTERM)).start()
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(Preempted):
        run_apart("train", [])
    assert signal.getsignal(signal.SIGTERM) == before


def stop_at_a(overrides: list[str]) -> None:
    if "policy=a" in overrides:
        raise Preempted("stopped by SIGTERM")


def test_a_job_of_a_cluster_that_is_told_to_stop_leaves_the_others_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(commands.RUN, "evaluate", stop_at_a)
    words = ["evaluate", "-m", "policy=a,b", f"output={tmp_path}", "hydra.launcher.n_jobs=1"]
    assert commands.main(words) == 128 + signal.SIGTERM, "joblib's jobs are told together"
    assert [job.state for job in find_jobs(tmp_path).values()] == ["stopped"]
    monkeypatch.setattr(sweep_job, "TOLD_TOGETHER", ())
    assert commands.main(words) == 1
    assert [job.state for job in find_jobs(tmp_path).values()] == ["stopped", "done"]
    assert "stopped: policy=a: stopped by SIGTERM" in capsys.readouterr().out


def test_a_launcher_that_breaks_leaves_an_account_of_every_job(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = Hydra.multirun

    def broken(*args: object, **choices: object) -> None:
        whole(*args, **choices)
        (tmp_path / "1" / "job.json").unlink()
        raise RuntimeError("a worker\ndied")

    monkeypatch.setattr(Hydra, "multirun", broken)
    monkeypatch.setitem(commands.RUN, "evaluate", lambda _: None)
    words = ["evaluate", "-m", "policy=a,b", f"output={tmp_path}", "hydra.launcher.n_jobs=1"]
    assert commands.main(words) == 1
    out, error = capsys.readouterr()
    assert out.splitlines() == [f"done: policy=a: {tmp_path}/0", "not begun: policy=b"]
    assert "1 of 2 jobs are not done (RuntimeError: a worker died)" in error


@pytest.mark.parametrize(
    ("choice", "extra"),
    [
        ("hydra/launcher=submitit_local", "submitit"),
        ("hydra/launcher=submitit_slurm", "submitit"),
        ("hydra/launcher=ray", "ray"),
        ("hydra/sweeper=optuna", "optuna"),
    ],
)
def test_a_missing_extra_is_named_in_one_line(
    choice: str, extra: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sweep, "find_spec", lambda _: None)
    assert commands.main(["train", "-m", choice, "train_seed=0,1"]) == 1
    says = f"hrl-comfort: {choice} needs the extra {extra}: pip install 'hrl-comfort[{extra}]'\n"
    assert capsys.readouterr().err == says


def test_a_search_is_told_the_success_and_nothing_of_a_failure() -> None:
    assert float(Ended("done", score=0.75)) == 0.75
    for ended in (Ended("failed", problem="no policy"), Ended("done", score=math.nan)):
        with pytest.raises(ValueError, match=r"no policy|no episode has ended"):
            float(ended)


@pytest.mark.parametrize(
    ("module", "choices"),
    [
        ("submitit", ["hydra/launcher=submitit_local", "policy=expert,/no/policy"]),
        ("optuna", ["hydra/sweeper=optuna", "hydra.sweeper.n_trials=2", "policy=expert,/no/policy"]),
        ("ray", ["hydra/launcher=ray", "policy=expert,/no/policy", "+hydra.launcher.ray.init.num_cpus=1"]),
    ],
)
def test_an_extra_runs_a_sweep_and_reports_who_fails(module: str, choices: list[str], tmp_path: Path) -> None:
    pytest.importorskip(module)
    words = ["evaluate", "-m", *choices, "task=reach", "episodes=1", f"output={tmp_path}"]
    command = [sys.executable, "-m", "hrl_comfort", *words]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 1
    assert "policy=/no/policy" in ran.stdout and "1 of 2 jobs failed" in ran.stderr
    assert sorted(job.state for job in find_jobs(tmp_path).values()) == ["done", "failed"]
