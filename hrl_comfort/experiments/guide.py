"""What acts in the guided rows of a training.

The field solves inverse kinematics, row after row, a good part of a decision's time. So it
is done in a process of its own (`guide_process`), while the learner learns from the decision before.
"""

from __future__ import annotations

import contextlib
import pickle
import signal
import subprocess
import sys
import weakref
from collections.abc import Callable

import torch
from torch import Tensor

from hrl_comfort.compose import environment
from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.meta.options import Act, make_policy
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.tasks import State, subtask

SLOW = ("field", "expert")
"""Guides that get a process of their own."""
COMMAND = (sys.executable, "-m", "hrl_comfort.experiments.guide_process")


def acting(config: TrainConfig, scene: Scene) -> Act:
    """Return what acts as `agent.guide` says.

    Raises:
        ConfigError: there is no such policy, or it does not go with this training.
    """
    source = config.agent.guide
    assert source is not None
    if source == "random":
        raise ConfigError("agent.guide=random shows nothing; choose field, expert or a run folder")
    task = subtask(config.task.name, config.task.observation, config.task.balls)
    try:
        return make_policy(source, task, scene, environment(config), config.train_seed)
    except ConfigError as error:
        raise ConfigError(f"agent.guide={source}: {error}") from error


class ActsApart:
    """Acts as `acting(config, ...)` does, in a process that lasts as long as this."""

    def __init__(self, config: TrainConfig) -> None:
        # It is deaf from its first moment: a training that is told to stop still has to decide.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
        try:
            self._process = subprocess.Popen(COMMAND, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        weakref.finalize(self, _end, self._process)
        self._send(config)

    def __call__(self, state: State) -> Callable[[], Tensor]:
        """Begin to think about a state; return what waits for the actions (N, 6) and returns them.

        Raises:
            RuntimeError: the process was killed. What went wrong in it is raised here.
        """
        self._send({name: value.numpy() for name, value in vars(state).items()})
        return self._receive

    def _send(self, what: object) -> None:
        assert self._process.stdin is not None
        try:
            pickle.dump(what, self._process.stdin)
            self._process.stdin.flush()
        except BrokenPipeError as error:
            raise self._killed() from error

    def _receive(self) -> Tensor:
        assert self._process.stdout is not None
        try:
            answer = pickle.load(self._process.stdout)  # of a process of our own
        except (EOFError, pickle.UnpicklingError) as error:
            raise self._killed() from error
        try:
            if isinstance(answer, Exception):
                raise answer
            return torch.from_numpy(answer)
        finally:
            del answer  # an error would keep this, and the process, alive

    def _killed(self) -> RuntimeError:
        self._process.kill()  # should it still be there
        return RuntimeError(f"the process of the guide has ended, with exit code {self._process.wait()}")


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the process; it has nothing to save."""
    assert process.stdin is not None and process.stdout is not None
    process.kill()
    process.wait()
    with contextlib.suppress(BrokenPipeError):
        process.stdin.close()
    process.stdout.close()
