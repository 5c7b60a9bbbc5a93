"""Calls in processes of their own: all are done, the first failure is raised, SIGTERM reaches what runs."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from hrl_comfort.config import ConfigError
from hrl_comfort.training.parallel import run_each
from hrl_comfort.training.preemption import Preempted, asked_to_stop


def written(path: Path) -> None:
    path.write_text(str(os.getpid()))


def until_stopped(path: Path) -> None:
    """Ask the parent to stop, or refuse, then wait for SIGTERM."""
    with asked_to_stop() as stop:
        if path.stem == "refuses":
            raise ConfigError("refused")
        if path.stem == "dies":
            os.kill(os.getpid(), signal.SIGKILL)
        if path.stem == "asks":
            os.kill(os.getppid(), signal.SIGTERM)
        while not stop():
            time.sleep(0.01)
    written(path)
    raise Preempted("stopped")


def test_every_call_is_done_in_a_process_of_its_own_or_here(tmp_path: Path) -> None:
    for jobs in (1, 2):
        files = [tmp_path / f"{jobs}_{number}" for number in range(3)]
        run_each(written, files, jobs)
        done = {int(file.read_text()) for file in files}
        assert done == {os.getpid()} if jobs == 1 else len(done) == 3 and os.getpid() not in done


def test_what_runs_beside_a_failure_is_stopped_and_the_failure_raised(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="refused"):
        run_each(until_stopped, [tmp_path / "refuses", tmp_path / "other", tmp_path / "never"], 2)
    assert not (tmp_path / "never").exists()
    with pytest.raises(RuntimeError, match="exit code -9"):
        run_each(until_stopped, [tmp_path / "dies", tmp_path / "other"], 2)


def test_sigterm_is_passed_on(tmp_path: Path) -> None:
    with pytest.raises(Preempted):
        run_each(until_stopped, [tmp_path / "asks", tmp_path / "other", tmp_path / "never"], 2)
    assert (tmp_path / "asks").exists() and not (tmp_path / "never").exists()
