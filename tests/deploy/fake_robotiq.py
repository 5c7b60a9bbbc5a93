"""A Robotiq hand's socket server: the answers to its lines, over a socket, or in the place of one."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.deploy.arms import Fingers, HandReading, Reading, SimulatedHand
from hrl_comfort.deploy.hands.robotiq import PORT


class FakeRobotiq:
    """The server, whose POS and OBJ are those that `read` returns.

    `values` of its other variables may be set; a line that `silent` begins with, unless empty, is not answered.
    """

    def __init__(self, read: Callable[[], HandReading]) -> None:
        self.values: dict[str, int | str] = {"STA": 3, "FLT": 0, "GTO": 0, "SPE": 0, "FOR": 0}
        self.position = round(255 * read().closed)
        self.silent = "never"
        self.lines: list[str] = []
        self._read = read

    def answer(self, line: str) -> bytes:
        self.lines.append(line)
        if line.startswith(self.silent):
            return b""
        kind, name, *value = line.split()
        if kind == "SET":
            if name == "POS":
                self.position = int(value[0])
            else:
                self.values[name] = int(value[0])
            return b"ack"  # without an end of line, as the real one
        hand = self._read()
        known = self.values | {"POS": round(255 * hand.closed), "OBJ": int(hand.fingers)}
        return f"{name} {known[name]}\n".encode()


class Loopback:
    """In the place of a socket: every line is answered at once, so that nothing depends on time."""

    def __init__(self, server: FakeRobotiq) -> None:
        self._server, self._said = server, b""

    def sendall(self, data: bytes) -> None:
        self._said += self._server.answer(data.decode().strip())

    def recv(self, size: int) -> bytes:
        if not self._said:
            raise BlockingIOError
        said, self._said = self._said, b""
        return said

    def setblocking(self, flag: bool) -> None:
        pass

    def close(self) -> None:
        pass


@contextmanager
def served(host: str, server: FakeRobotiq) -> Iterator[None]:
    """Serve one client on a loopback address."""

    def serve() -> None:
        connection = listener.accept()[0]
        with suppress(ConnectionError), connection, connection.makefile("rb") as lines:
            for line in lines:
                connection.sendall(server.answer(line.decode().strip()))

    with socket.create_server((host, PORT)) as listener:
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield
    thread.join()


class RobotiqWorld:
    """The arm of a world without its hand, whose fingers follow `server`, and which tells that what is between them."""

    def __init__(self, world: SimulatedHand) -> None:
        self._world = world
        self.server = FakeRobotiq(self._hand)

    def _hand(self) -> HandReading:
        hand = self._world.read().hand
        assert hand is not None
        return hand

    def read(self) -> Reading:
        return replace(self._world.read(), hand=None)

    def send(self, angles: NDArray[np.float64]) -> None:
        self._world.send(np.append(angles, self.server.position / 255))

    def bits(self) -> tuple[int, int]:
        """Return digital outputs and inputs as if the hand were on the tool connector."""
        shut, gripped = self.server.position > 127, self._hand().fingers == Fingers.GRIP
        return shut << 16, gripped << 16

    def lay(self, objects: NDArray[np.float64] | None) -> None:
        if objects is not None:
            self._world.lay(objects)

    def close(self) -> None:
        self._world.close()


def still() -> HandReading:
    return HandReading(0.0, Fingers.THERE)
