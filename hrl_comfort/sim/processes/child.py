"""Child process: simulates some rows of an engine as its parent says."""

from __future__ import annotations

import os
import pickle
import signal
import warnings
from collections.abc import Callable
from dataclasses import fields
from multiprocessing.connection import Connection
from traceback import format_exception
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from hrl_comfort.humans import EvaluationSet
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.processes.memory import Arrays, Layout, Memory
from hrl_comfort.sim.step_result import StepResult

Rest = Arrays | None
"""Arrays for which there is no shared memory yet; None if they have been written to it."""
PLANNED = ("noise", "frames")
"""Fields of a `Draw` that are long, and that the parent does not need."""
STATE, PHYSICS = "state", "physics"
RESULT = tuple(each.name for each in fields(StepResult) if each.name not in ("state", "before", "moving"))
"""Fields of `StepResult` that are tensors."""


class Child:
    """Rows from `begin` on of an engine; `engine` has them alone. Names of methods are what a parent may ask for."""

    def __init__(self, engine: Engine, begin: int) -> None:
        self._engine, self._begin, self._memory = engine, begin, dict[str, Memory]()

    def attach(self, group: str, layout: Layout, name: str) -> None:
        """Write the arrays of `group` to shared memory from now on."""
        self._memory[group] = Memory(layout, name)

    def take(self, changed: Arrays) -> None:
        """Take fields (n, ...) of the state that the parent changed."""
        if changed:
            self._engine.episodes.measured(**changed)

    def reset(
        self,
        rows: NDArray[np.int64],
        entries: EvaluationSet | None,
        latest: NDArray[np.int64],
        settings: dict[str, Any],
    ) -> tuple[Rest, Arrays]:
        """Begin episodes in `rows` (r,), after the `latest` (n,) of every row; return state and draws (r, ...)."""
        episodes = self._engine.episodes
        episodes.precision_m, episodes.episode[:] = settings["precision_m"], latest
        episodes.sampler.seed, episodes.sampler.reach = settings["seed"], settings["reach"]
        if len(rows):
            self._engine.reset(rows, entries)
        draw = {name: value[rows] for name, value in vars(episodes.draw).items() if name not in PLANNED}
        return self._state(), draw

    def step(
        self, action: NDArray[np.float64], rows: NDArray[np.int64] | None, held: NDArray[np.int64]
    ) -> tuple[Rest, Rest]:
        """Run a decision, in `rows` (r,) if given, while those `held` stay as they are; return state and result."""
        if rows is not None and not len(rows):
            return self._state(), None
        if len(held):
            with self._engine.held(torch.from_numpy(held)):
                result = self._engine.step(action, rows)
        else:
            result = self._engine.step(action, rows)
        arrays = {name: getattr(result, name).numpy() for name in RESULT}
        return self._state(), self._written("result", {**arrays, **result.moving})

    def observe(self) -> Rest:
        """Return the observations."""
        return self._written("observation", {"observation": self._engine.observe().numpy()})

    def state_dict(self) -> dict[str, Any]:
        """See `Engine`."""
        return self._engine.state_dict()

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """See `Engine`."""
        self._engine.load_state_dict(saved)

    def _state(self) -> Rest:
        state = self._engine.episodes.state
        if state is None:  # no row has been reset
            return None
        arrays = {name: value.numpy() for name, value in state.fields().items()}
        return self._written(STATE, {**arrays, PHYSICS: self._engine.physics_state})

    def _written(self, group: str, arrays: Arrays) -> Rest:
        if group not in self._memory:
            return arrays
        self._memory[group].write(self._begin, arrays)
        return None


def with_trace(error: BaseException) -> BaseException:
    """Return an error for another process: with its traceback as a note, and one that can be pickled."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001
        error = RuntimeError(f"{type(error).__name__}: {error}").with_traceback(error.__traceback__)
    error.add_note(f"In process {os.getpid()}:\n{''.join(format_exception(error))}")
    return error


def serve(connection: Connection, make: Callable[[], Child]) -> None:
    """Do what the parent asks for until it ends, or closes the connection.

    Signals are the parent's business: Ctrl-C, and the SIGTERM after which a training still writes its checkpoint.
    """
    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, signal.SIG_IGN)
    warnings.simplefilter("ignore")  # the parent has said it
    torch.set_num_threads(1)
    try:
        child, message = None, b""
        while True:
            try:
                if child is None:
                    child, answer = make(), None
                else:
                    asked, changed, words = pickle.loads(message)
                    child.take(changed)
                    answer = getattr(child, asked)(*words)
                told = pickle.dumps(answer, protocol=5)
            except Exception as error:  # noqa: BLE001
                told = pickle.dumps(with_trace(error), protocol=5)
            connection.send_bytes(told)
            message = connection.recv_bytes()
    except (EOFError, OSError):  # the parent is gone
        return
