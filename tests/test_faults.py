"""A training that is killed, preempted or out of disk loses nothing."""

from __future__ import annotations

import os
import resource
import signal
import time
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from hrl_comfort.agents import checkpoint
from hrl_comfort.config import ConfigError
from hrl_comfort.files.provenance import is_finished
from hrl_comfort.files.state_file import FORMAT
from hrl_comfort.training.preemption import Preempted
from hrl_comfort.training.trainer import train
from tests.point_env import make_points, small_config

KILLS = 20
OUT_OF_DISK, PREEMPTED = 7, 8


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """Return the folder of an undisturbed training."""
    return train(small_config(tmp_path_factory.mktemp("runs") / "whole"), make_points)


def go_on(folder: Path) -> None:
    """Start or continue the training in `folder`."""
    resumable = (folder / "checkpoints" / "latest.pt", folder / "checkpoints" / "previous.pt")
    begun = any(path.exists() for path in resumable)
    train(small_config(folder, resume=str(folder) if begun else None), make_points)


def child(work: Callable[[], None]) -> int:
    """Run `work` in a child process; return its id."""
    pid = os.fork()
    if pid:
        return pid
    code = 1
    try:
        work()
        code = 0
    except Preempted:
        code = PREEMPTED
    except OSError:
        code = OUT_OF_DISK
    except Exception:  # noqa: BLE001  the parent sees the exit code, the reader this
        traceback.print_exc()
    finally:
        os._exit(code)


def stopped(folder: Path) -> None:
    """Train in `folder` until the first row, then stop it by SIGTERM, long before its end."""
    pid = child(lambda: go_on(folder))
    log = folder / "metrics.csv"
    while not log.exists() or len(log.read_text().splitlines()) < 2:
        assert os.waitpid(pid, os.WNOHANG) == (0, 0), "it ended before its first row"
        time.sleep(0.01)
    os.kill(pid, signal.SIGTERM)
    _, status = os.waitpid(pid, 0)
    assert os.waitstatus_to_exitcode(status) == PREEMPTED


def same_end(folder: Path, whole: Path) -> None:
    assert (folder / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()
    for name in ("policy.pt", "checkpoints/best.pt"):
        mine, theirs = (checkpoint.load(each / name) for each in (folder, whole))
        assert mine["counters"] == theirs["counters"]
        for key, tensor in theirs["networks"]["actor"].items():
            assert torch.equal(tensor, mine["networks"]["actor"][key])


def test_twenty_kills_at_random_moments_change_nothing(whole: Path, tmp_path: Path) -> None:
    rng, kills, round_ = np.random.default_rng(0), 0, 0
    while kills < KILLS:
        folder = tmp_path / str(round_)
        while not is_finished(folder):
            if kills == KILLS:
                go_on(folder)
                break
            pid = child(partial(go_on, folder))
            time.sleep(rng.uniform(0.05, 0.8))
            os.kill(pid, signal.SIGKILL)
            _, status = os.waitpid(pid, 0)
            if os.WIFSIGNALED(status):
                kills += 1
            else:
                assert os.WEXITSTATUS(status) == 0
        same_end(folder, whole)
        round_ += 1


def test_a_training_that_gets_sigterm_writes_a_checkpoint_and_continues_from_it(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "told"
    stopped(folder)
    assert checkpoint.load(folder / "checkpoints" / "latest.pt")["policy_steps"] >= 200
    go_on(folder)
    same_end(folder, whole)


def test_a_full_disk_leaves_the_last_checkpoint_good(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "full"
    stopped(folder)

    def with_little_room() -> None:
        soft = 60_000  # the tables fit, the replay buffer does not
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
        go_on(folder)

    _, status = os.waitpid(child(with_little_room), 0)
    assert os.waitstatus_to_exitcode(status) == OUT_OF_DISK
    go_on(folder)
    same_end(folder, whole)


class Evil:
    """An object that writes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, ...]:
        return (os.system, (f"touch {self.path}",))


def test_loading_a_policy_runs_nothing_that_is_in_it(tmp_path: Path) -> None:
    trap, file = tmp_path / "sprung", tmp_path / "policy.pt"
    torch.save({"format": FORMAT, "networks": Evil(trap)}, file)
    with pytest.raises(ConfigError, match=r"policy\.pt: cut short or not a checkpoint"):
        checkpoint.load(file)
    assert not trap.exists()
