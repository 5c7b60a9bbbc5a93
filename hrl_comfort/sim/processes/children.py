"""Child processes of an engine, and what the parent says to them."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from multiprocessing.util import Finalize
from typing import Any

from hrl_comfort.sim.processes.child import Child, serve
from hrl_comfort.sim.processes.memory import Arrays

WAIT_S = 10.0
"""Time in which a process ends by itself once nobody asks it for anything, s."""


class Children:
    """A process for each of `makes`, which make what answers there; they end with this one.

    Raises:
      ChildProcessError: a process ended.
      Exception: what a child raised.
    """

    def __init__(self, makes: Sequence[Callable[[], Child]]) -> None:
        context = get_context("spawn")
        self._connections, self._processes = list[Connection](), list[BaseProcess]()
        # With a priority it is called at exit too, before `multiprocessing` waits for processes that wait for a word.
        self.close = Finalize(self, _end, (self._connections, self._processes), exitpriority=1)
        for make in makes:
            ours, theirs = context.Pipe()
            process = context.Process(target=serve, args=(theirs, make), daemon=True)
            process.start()
            theirs.close()
            self._connections.append(ours)
            self._processes.append(process)
        self._checked(self._answers())

    def ask(self, what: str, changed: Sequence[Arrays], words: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Return the answers of all to `Child.what`, each given its `words`, after it took what has `changed`."""
        messages = [pickle.dumps((what, *message), protocol=5) for message in zip(changed, words, strict=True)]
        try:
            for index, message in enumerate(messages):
                try:
                    self._connections[index].send_bytes(message)
                except OSError as error:
                    raise self._ended(index) from error
            answers = self._answers()
        except BaseException:  # what has not been answered would be taken for the answer to the next word
            self.close()
            raise
        return self._checked(answers)

    def _answers(self) -> list[Any]:
        return [self._answer(index) for index in range(len(self._processes))]

    def _checked(self, answers: list[Any]) -> list[Any]:
        for answer in answers:
            if isinstance(answer, BaseException):
                raise answer
        return answers

    def _answer(self, index: int) -> Any:
        try:
            return pickle.loads(self._connections[index].recv_bytes())
        except (EOFError, OSError):
            return self._ended(index)

    def _ended(self, index: int) -> ChildProcessError:
        process, count = self._processes[index], len(self._processes)
        process.join(WAIT_S)
        return ChildProcessError(
            f"process {process.pid}, number {index + 1} of engine.processes={count}, ended with exit code "
            f"{process.exitcode}; it may have run out of memory: lower engine.num_envs or engine.processes"
        )


def _end(connections: list[Connection], processes: list[BaseProcess]) -> None:
    """End `processes`, which end by themselves when their `connections` are closed."""
    for connection in connections:
        connection.close()
    for process in processes:
        process.join(WAIT_S)
        if process.is_alive():
            process.kill()
