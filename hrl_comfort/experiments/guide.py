"""What acts in the guided rows of a training.

Inverse kinematics takes a third of a decision's time, so it is solved in a process of its own, while the
learner learns from the decision before.
"""

from __future__ import annotations

import os
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
from hrl_comfort.scene.workcell import Scene, build_scene
from hrl_comfort.tasks import State, subtask

SLOW = ("field", "expert")
"""Guides that get a process of their own."""


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
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        weakref.finalize(self, _end, self._process)
        self._send(config)

    def __call__(self, state: State) -> Callable[[], Tensor]:
        """Begin to think about a state; return what waits for the actions (N, 6) and returns them."""
        self._send({name: value.numpy() for name, value in vars(state).items()})
        return self._receive

    def _send(self, what: object) -> None:
        assert self._process.stdin is not None
        try:
            pickle.dump(what, self._process.stdin)
            self._process.stdin.flush()
        except BrokenPipeError as error:
            raise self._ended() from error

    def _receive(self) -> Tensor:
        assert self._process.stdout is not None
        try:
            return torch.from_numpy(pickle.load(self._process.stdout))  # of our own process
        except (EOFError, pickle.UnpicklingError) as error:
            raise self._ended() from error

    def _ended(self) -> RuntimeError:
        return RuntimeError(f"the process of the guide has ended, with exit code {self._process.wait()}")


def _end(process: subprocess.Popen[bytes]) -> None:
    assert process.stdin is not None and process.stdout is not None
    process.stdin.close()  # at which it ends
    process.stdout.close()
    process.wait()


def main() -> None:
    """Act for the process that started this one: a configuration comes in, then states; actions go out."""
    for number in (signal.SIGINT, signal.SIGTERM):  # a training that is told to stop still has to decide
        signal.signal(number, signal.SIG_IGN)
    asked, told = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever else is printed
    torch.set_num_threads(1)
    config: TrainConfig = pickle.load(asked)
    act = acting(config, build_scene(config.robot, config.cell, config.engine.substeps, config.task.balls))
    while True:
        try:
            state = pickle.load(asked)
        except EOFError:
            return
        action = act(State(**{name: torch.from_numpy(value) for name, value in state.items()}))
        pickle.dump(action.numpy(), told)
        told.flush()


if __name__ == "__main__":
    main()
