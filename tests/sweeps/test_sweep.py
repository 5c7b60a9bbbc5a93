"""Sweeps: jobs that fail, are killed or stopped are reported, and the others continue."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from hrl_comfort.cli import main as commands
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig
from hrl_comfort.config.hydra_conf import hydra_over_conf
from hrl_comfort.files.output import held_folder
from hrl_comfort.files.provenance import RunState
from hrl_comfort.files.run_config import save_config
from hrl_comfort.files.sweep_record import Job, find_jobs, read_job
from hrl_comfort.sweeps import job as sweep_job
from hrl_comfort.sweeps import launcher as sweep
from hrl_comfort.sweeps import subprocesses
from hrl_comfort.sweeps.job import JobResult
from hrl_comfort.sweeps.subprocesses import KilledError, run_in_subprocess
from hrl_comfort.training.preemption import Preempted

with hydra_over_conf() as state:
    HYDRA = type(state.hydra)

Script = Callable[[str], None]


@pytest.fixture
def says(monkeypatch: pytest.MonkeyPatch) -> Script:
    """Return a function that replaces the command by a script."""

    def stand_in(script: str) -> None:
        monkeypatch.setattr(subprocesses, "COMMAND", (sys.executable, "-c", script))

    return stand_in


def test_a_job_that_gets_sigterm_during_its_start_has_stopped(says: Script) -> None:
    says("import time; time.sleep(60)")  # as during the imports
    alarm = threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGTERM))
    alarm.start()
    with pytest.raises(Preempted, match="stopped by SIGTERM"):
        run_in_subprocess("train", [])
    alarm.join()


def test_a_job_in_a_subprocess_reports_its_error(says: Script) -> None:
    says("import sys; print('warning', file=sys.stderr); sys.exit('hrl-comfort: no such policy')")
    with pytest.raises(ConfigError, match=r"^no such policy$"):
        run_in_subprocess("train", [])
    says("import os; os.kill(os.getpid(), 9)")
    with pytest.raises(KilledError, match="ended by SIGKILL, perhaps for want of memory"):
        run_in_subprocess("train", [])
    says("import sys; print('hrl-comfort: go on with resume=a', file=sys.stderr); sys.exit(143)")
    with pytest.raises(Preempted, match=r"^go on with resume=a$"):
        run_in_subprocess("train", [])
    says("")
    run_in_subprocess("train", [])


def test_sigterm_is_forwarded_to_the_subprocess(says: Script) -> None:
    says(
        "import signal, sys, time\n"
        "signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))\n"
        "print('ready', file=sys.stderr, flush=True); time.sleep(30)"
    )
    threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGTERM)).start()
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(Preempted):
        run_in_subprocess("train", [])
    assert signal.getsignal(signal.SIGTERM) == before


def stop_at_a(overrides: list[str]) -> None:
    if "policy=a" in overrides:
        raise Preempted("stopped by SIGTERM")


def test_a_stopped_job_of_a_cluster_leaves_the_others_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(commands.RUN, "evaluate", stop_at_a)
    words = ["evaluate", "-m", "policy=a,b", f"output={tmp_path}", "hydra.launcher.n_jobs=1"]
    assert commands.main(words) == 128 + signal.SIGTERM, "joblib's jobs are told together"
    assert [job.state for job in find_jobs(tmp_path).values()] == ["stopped"]
    monkeypatch.setattr(sweep_job, "LOCAL_LAUNCHERS", ())
    assert commands.main(words) == 1
    assert [job.state for job in find_jobs(tmp_path).values()] == ["stopped", "done"]
    assert "stopped: policy=a: stopped by SIGTERM" in capsys.readouterr().out


def test_every_job_is_reported_after_a_crash_of_the_launcher(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = HYDRA.multirun

    def broken(*args: object, **choices: object) -> None:
        whole(*args, **choices)
        (tmp_path / "1" / "job.json").unlink()
        raise RuntimeError("a worker\ndied")

    monkeypatch.setattr(HYDRA, "multirun", broken)
    monkeypatch.setitem(commands.RUN, "evaluate", lambda _: None)
    words = ["evaluate", "-m", "policy=a,b", f"output={tmp_path}", "hydra.launcher.n_jobs=1"]
    assert commands.main(words) == 1
    out, error = capsys.readouterr()
    assert out.splitlines() == [f"done: policy=a: {tmp_path}/0", "not started: policy=b"]
    assert "1 of 2 jobs are not done (RuntimeError: a worker died)" in error


def test_a_job_that_was_lost_is_reported_as_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = HYDRA.multirun

    def losing(*args: object, **choices: object) -> None:
        whole(*args, **choices)
        replace(read_job(tmp_path / "1"), state="running").write(tmp_path / "1")  # as after a kill
        raise RuntimeError("Job 1 has not produced any output")

    monkeypatch.setattr(HYDRA, "multirun", losing)
    monkeypatch.setitem(commands.RUN, "evaluate", lambda _: None)
    words = ["evaluate", "-m", "policy=a,b", f"output={tmp_path}", "hydra.launcher.n_jobs=1"]
    assert commands.main(words) == 1
    out, error = capsys.readouterr()
    assert out.splitlines()[1] == f"failed: policy=b: no result in {tmp_path}/1: it was killed, or still runs"
    assert "1 of 2 jobs are not done (RuntimeError: Job 1 has not produced any output)" in error


def descendants(pid: int) -> set[int]:
    """Return the living processes below `pid`."""
    parents = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, parent = stat.read_text().rpartition(")")[2].split()[:2]
            if state != "Z":
                parents[int(stat.parent.name)] = int(parent)
    below, found = {pid}, set[int]()
    while below:
        below = {child for child, parent in parents.items() if parent in below}
        found |= below
    return found


def alive(pid: int) -> bool:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


@pytest.mark.skipif(sys.platform != "linux", reason="PR_SET_PDEATHSIG is Linux's")
def test_a_sweep_that_is_killed_leaves_no_process_behind(tmp_path: Path) -> None:
    words = ["train", "-m", "task=reach", "train_seed=0,1", "hydra.launcher.n_jobs=3", f"output={tmp_path}"]
    command = [sys.executable, "-m", "hrl_comfort", *words]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as sweeping:
        end = time.monotonic() + 300
        while not all((tmp_path / str(job) / "config.yaml").is_file() for job in range(2)):
            assert sweeping.poll() is None and time.monotonic() < end, "the jobs have not started"
            time.sleep(0.2)
        below = descendants(sweeping.pid)
        sweeping.kill()
    end = time.monotonic() + 60
    while any(map(alive, below)) and time.monotonic() < end:
        time.sleep(0.1)
    assert len(below) >= 5 and not [pid for pid in below if alive(pid)]


def test_a_worker_imports_neither_torch_nor_pandas() -> None:
    code = "import sys, hrl_comfort.sweeps.launcher; print(*sorted({'torch', 'pandas', 'mujoco'} & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


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


def test_an_unknown_launcher_or_sweeper_is_told_the_known_ones(capsys: pytest.CaptureFixture[str]) -> None:
    for key, known in (
        ("launcher", "basic, joblib, ray, submitit_local, submitit_slurm"),
        ("sweeper", "basic, optuna"),
    ):
        assert commands.main(["train", "-m", f"hydra/{key}=slrum", "train_seed=0,1"]) == 1
        says = f"hrl-comfort: hydra/{key}='slrum' is not allowed; choose one of {known}\n"
        assert capsys.readouterr().err == says


def test_a_search_gets_the_score_and_an_error_for_a_failure() -> None:
    assert float(JobResult("done", score=0.75)) == 0.75
    for result in (JobResult("failed", error="no policy"), JobResult("done", score=math.nan)):
        with pytest.raises(ValueError, match=r"no policy|no episode has ended"):
            float(result)


@pytest.mark.parametrize(
    ("module", "choices"),
    [
        ("submitit", ["hydra/launcher=submitit_local", "policy=expert,/no/policy"]),
        ("optuna", ["hydra/sweeper=optuna", "hydra.sweeper.n_trials=2", "policy=expert,/no/policy"]),
        ("ray", ["hydra/launcher=ray", "policy=expert,/no/policy", "+hydra.launcher.ray.init.num_cpus=1"]),
    ],
)
def test_an_extra_runs_a_sweep_and_reports_failures(module: str, choices: list[str], tmp_path: Path) -> None:
    pytest.importorskip(module)
    words = ["evaluate", "-m", *choices, "task=reach", "episodes=1", f"output={tmp_path}"]
    command = [sys.executable, "-m", "hrl_comfort", *words]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 1
    assert "policy=/no/policy" in ran.stdout and "1 of 2 jobs failed" in ran.stderr
    assert sorted(job.state for job in find_jobs(tmp_path).values()) == ["done", "failed"]


def test_evaluations_of_several_runs_go_to_the_runs(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("a", "my run"):
        save_config(compose("train", ["task=reach"]), tmp_path / name / "config.yaml")  # without a policy
    assert commands.main(["evaluate", "-m", "a/", "my run", "hydra/launcher=basic", "episodes=1"]) == 1
    assert "2 of 2 jobs failed" in capsys.readouterr().err
    for name in ("a", "my run"):
        assert read_job(tmp_path / name / "eval").state == "failed"
    assert commands.main(["evaluate", "a", "my run"]) == 1
    assert "add -m to evaluate each" in capsys.readouterr().err
    assert commands.main(["evaluate", "-m", "a", "hydra/launcher=basic", "human=arc,still"]) == 1
    assert len(find_jobs(max((tmp_path / "runs" / "sweep").iterdir()))) == 2


@pytest.mark.parametrize(
    ("policy", "age_s", "state"),
    [
        ("{file}", 1, RunState.FINISHED),
        ("{file}", -1, RunState.NEW),
        ("sb3:{file}", 1, RunState.FINISHED),
        ("sb3:{file}", -1, RunState.NEW),
        ("onnx:{file}", -1, RunState.NEW),
        ("my_package.policies:mine", 1, RunState.NEW),
        ("expert", 1, RunState.FINISHED),
    ],
)
def test_an_evaluation_is_finished_while_it_is_newer_than_its_policy(
    policy: str, age_s: float, state: RunState, tmp_path: Path
) -> None:
    """`age_s` is the age of the policy's file when the evaluation was written."""
    file, output = tmp_path / "policy", tmp_path / "eval"
    asked = compose("evaluate", ["task=reach", f"policy='{policy.format(file=file)}'", f"output='{output}'"])
    assert isinstance(asked, EvaluateConfig)
    save_config(asked, output / "config.yaml")
    for each, time_s in (file, 1000.0 - age_s), (output / "summary.json", 1000.0):
        each.touch()
        os.utime(each, (time_s, time_s))
    assert sweep_job.state_of(asked) is state


def test_jobs_that_a_launcher_has_left_are_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "0").mkdir()
    for command in ("mine", "another"):
        (tmp_path / command).mkdir()
        Job("train", ("task=reach",), "running", command=command).write(tmp_path / command)
    waited = []
    with contextlib.ExitStack() as runs:
        runs.enter_context(held_folder(tmp_path / "another"))
        mine = runs.enter_context(contextlib.ExitStack())
        mine.enter_context(held_folder(tmp_path / "mine"))
        monkeypatch.setattr(sweep.time, "sleep", lambda seconds: (waited.append(seconds), mine.close()))
        sweep._wait(tmp_path, "mine")
    assert waited == [sweep.POLL_S]


@pytest.mark.parametrize("name", ["joblib", "submitit_local", "ray"])
def test_jobs_of_launchers_that_give_up_with_a_worker_run_in_subprocesses(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = []
    chosen = {"hydra/launcher": name, "hydra/sweeper": "basic"}
    hydra = SimpleNamespace(
        runtime=SimpleNamespace(output_dir=str(tmp_path / "0"), choices=chosen),
        overrides=SimpleNamespace(task=["task=reach"]), launcher={},
    )  # fmt: skip
    monkeypatch.setattr(sweep_job.HydraConfig, "get", lambda: hydra)
    monkeypatch.setattr(sweep_job, "run_in_subprocess", lambda verb, words: ran.append(words))
    result = sweep_job.job("train", lambda words: pytest.fail("in the worker"), "mine", None)
    assert result.error is None and ran == [["task=reach", f"output={tmp_path / '0'}"]]
