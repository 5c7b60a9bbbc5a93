"""A controller of Universal Robots on a loopback address, in a process of its own: RTDE, one script, and a hand.

It speaks RTDE 2 on port 30004 and takes URScript on port 30002. Of a script it reads the watchdog, how long it waits
for the counter and how it brakes; it follows the registers as `servoj` does. The arm is MuJoCo's. With a hand there is
also the server of a Robotiq, on port 63352: what it says of the fingers is what lies between them in that world. A
script that switches the tool's output moves the same fingers by that, and the tool's input tells a grip.
"""

from __future__ import annotations

import heapq
import itertools
import multiprocessing
import re
import select
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.deploy.arms import PERIOD_S, SimulatedArm, SimulatedHand
from hrl_comfort.deploy.links import prefer
from hrl_comfort.scene.workcell import Scene
from tests.deploy.fake_robotiq import PORT, FakeRobotiq, RobotiqWorld

TYPES = {
    "timestamp": "d", "actual_q": "6d", "actual_qd": "6d", "target_q": "6d", "robot_mode": "i", "safety_mode": "i",
    "runtime_state": "I", **{f"input_int_register_{k}": "i" for k in range(48)},
    **{f"input_double_register_{k}": "d" for k in range(48)},
    "actual_digital_output_bits": "Q", "actual_digital_input_bits": "Q",
}  # fmt: skip
NAMES = {"d": "DOUBLE", "6d": "VECTOR6D", "i": "INT32", "I": "UINT32", "Q": "UINT64"}
STOPPED, PLAYING = 1, 2
NORMAL, PROTECTIVE, EMERGENCY = 1, 3, 7


@dataclass(frozen=True)
class Faults:
    """Faults of the robot and its network."""

    latency_s: float = 0.0
    """Of packages in each direction."""
    jitter_s: float = 0.0
    """Largest further delay, uniform; packages keep their order."""
    loss: float = 0.0
    """Share of packages that never arrive."""
    lag_s: float = 0.0
    """Low-pass filter of the set-points, besides the servo's own lag."""
    seed: int = 0


class Peer:
    """A client of RTDE."""

    def __init__(self, connection: socket.socket) -> None:
        self.socket, self.data = connection, b""
        self.outputs: list[str] = []
        self.inputs: list[list[str]] = []
        self.started = False


class Controller:
    """The controller; `run` until the pipe is closed, on which it takes safety modes and tells the arm's state.

    The arm is a model's, at `start`, or at home with the hand of a scene, before which `objects` (B, 7) lie.
    """

    def __init__(
        self,
        host: str,
        world: mujoco.MjModel | Scene,
        start: NDArray[np.float64],
        faults: Faults,
        objects: NDArray[np.float64] | None,
    ) -> None:
        self._faults, self._rng = faults, np.random.default_rng(faults.seed)
        ports = [30004, 30002]
        self._arm: SimulatedArm | RobotiqWorld
        if isinstance(world, Scene):
            self._arm = RobotiqWorld(SimulatedHand(world))
            self._arm.lay(objects)
            self._hand: FakeRobotiq = self._arm.server
            ports.append(PORT)
        else:
            self._arm = SimulatedArm(world, start)
        self._listeners = {port: socket.create_server((host, port)) for port in ports}
        self._clients: list[socket.socket] = []
        self._peers: list[Peer] = []
        self._senders: list[socket.socket] = []
        self._queue: list[tuple[float, int, Any]] = []
        self._order, self._last = itertools.count(), {"in": 0.0, "out": 0.0}
        self._values: dict[str, Any] = {name: 0 for name in TYPES if name.startswith("input")}
        self._values |= {"robot_mode": 7, "safety_mode": NORMAL, "runtime_state": STOPPED}
        self._script = self._switch = ""
        self._target = start.copy()
        self._speed = np.zeros_like(start)
        self._fed_s = self._changed_s = 0.0

    def run(self, pipe: Connection) -> None:
        prefer(40)
        due = time.monotonic()
        while True:
            if pipe.poll():
                try:
                    self._values["safety_mode"] = pipe.recv()
                except EOFError:
                    return
                reading = self._arm.read()
                pipe.send((reading.angles, reading.velocity))
            due = max(due + PERIOD_S, time.monotonic() - PERIOD_S)
            self._listen(0.0)  # also where a busy machine leaves no time
            while (left := due - time.monotonic()) > 0:
                self._listen(left)
            self._control()

    def _listen(self, wait_s: float) -> None:
        peers = [peer.socket for peer in self._peers]
        sockets = [*self._listeners.values(), *peers, *self._senders, *self._clients]
        for ready in select.select(sockets, [], [], wait_s)[0]:
            if ready is self._listeners[30004]:
                self._peers.append(Peer(ready.accept()[0]))
                self._peers[-1].socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            elif ready is self._listeners[30002]:
                self._senders.append(ready.accept()[0])
            elif ready is self._listeners.get(PORT):
                self._clients.append(ready.accept()[0])
            elif ready in self._clients:
                line = ready.recv(1024).decode()
                if line:
                    ready.sendall(self._hand.answer(line.strip()))
                else:
                    self._clients.remove(ready)
            elif ready in self._senders:
                text = ready.recv(65536).decode()
                if not text:
                    self._senders.remove(ready)
                elif self._values["safety_mode"] == NORMAL:
                    self._begin(text)
            else:
                peer = next(each for each in self._peers if each.socket is ready)
                try:
                    data = ready.recv(65536)
                except ConnectionError:
                    data = b""
                peer.data += data
                if not data:
                    self._peers.remove(peer)
                while len(peer.data) >= 3 and len(peer.data) >= (size := struct.unpack(">H", peer.data[:2])[0]):
                    package, peer.data = peer.data[2:size], peer.data[size:]
                    self._answer(peer, package[:1], package[1:])

    def _begin(self, text: str) -> None:
        found = re.search(r'rtde_set_watchdog\("(\w+)", (\d+), "stop"\)', text)
        number = re.search(r"while read_input_integer_register\((\d+)\) != (\d+):", text)
        stale, brake = re.search(r"stale < (\d+)", text), re.search(r"stopj\(([\d.]+)\)", text)
        assert found and number and stale and brake, text
        self._number = f"input_int_register_{number[1]}", int(number[2])
        self._counter, self._watchdog_s = found[1], 1 / float(found[2])
        self._stale_s, self._brake = float(stale[1]) * PERIOD_S, float(brake[1])
        switch = re.search(r"shut = read_input_integer_register\((\d+)\)\n +set_tool_digital_out\(0, shut == 1\)", text)
        self._switch = f"input_int_register_{switch[1]}" if switch else ""
        self._script, self._values["runtime_state"] = text, PLAYING
        self._fed_s = self._changed_s = time.monotonic()
        self._seen = None

    def _answer(self, peer: Peer, kind: bytes, payload: bytes) -> None:
        if kind == b"V":
            self._tell(peer, kind, b"\x01")
        elif kind == b"v":
            self._tell(peer, kind, struct.pack(">4I", 5, 13, 0, 0))
        elif kind == b"O":
            peer.outputs = payload[8:].decode().strip(",").split(",")
            types = ",".join(NAMES[TYPES[name]] if name in TYPES else "NOT_FOUND" for name in peer.outputs)
            self._tell(peer, kind, b"\x01" + types.encode())
        elif kind == b"I":
            names = payload.decode().split(",")
            peer.inputs.append(names)
            self._tell(peer, kind, bytes([len(peer.inputs)]) + ",".join(NAMES[TYPES[name]] for name in names).encode())
        elif kind in b"SP":
            peer.started = kind == b"S"
            self._tell(peer, kind, b"\x01")
        elif kind == b"U":
            self._delay("in", (peer.inputs[payload[0] - 1], payload[1:]))

    def _tell(self, peer: Peer, kind: bytes, payload: bytes) -> None:
        try:
            peer.socket.sendall(struct.pack(">Hc", 3 + len(payload), kind) + payload)
        except OSError:
            peer.started = False

    def _delay(self, way: str, package: Any) -> None:
        faults = self._faults
        if self._rng.random() < faults.loss:
            return
        arrives = time.monotonic() + faults.latency_s + faults.jitter_s * self._rng.random()
        self._last[way] = max(arrives, self._last[way])
        heapq.heappush(self._queue, (self._last[way], next(self._order), (way, package)))

    def _control(self) -> None:
        now = time.monotonic()
        while self._queue and self._queue[0][0] <= now:
            way, package = heapq.heappop(self._queue)[2]
            if way == "out":
                self._tell(package[0], b"U", package[1])
                continue
            names, data = package
            values = struct.unpack(">" + "".join(TYPES[name] for name in names), data)
            self._values |= dict(zip(names, values, strict=True))
            self._fed_s = now
        self._follow(now)
        if self._switch and self._script and self._seen is not None:
            self._hand.position = 255 * (self._values[self._switch] == 1)
        self._arm.send(self._target)
        reading = self._arm.read()
        values = {**self._values, "timestamp": now, "actual_q": reading.angles, "actual_qd": reading.velocity}
        values |= {"actual_digital_output_bits": 0, "actual_digital_input_bits": 0}
        if isinstance(self._arm, RobotiqWorld):
            values["actual_digital_output_bits"], values["actual_digital_input_bits"] = self._arm.bits()
        for peer in self._peers:
            if peer.started and peer.outputs:
                packed = [struct.pack(">" + TYPES[name], *np.atleast_1d(values[name])) for name in peer.outputs]
                self._delay("out", (peer, b"\x01" + b"".join(packed)))

    def _follow(self, now: float) -> None:
        """Follow the registers as the script says, or brake."""
        if self._script:
            register, number = self._number
            if self._values[register] == number and (count := self._values[self._counter]) != self._seen:
                self._seen, self._changed_s = count, now
            if self._seen is None:
                self._changed_s = now
            stale = now - self._changed_s > self._stale_s or now - self._fed_s > self._watchdog_s
            if stale or (self._seen or 0) < 0 or self._values["safety_mode"] != NORMAL:
                self._script, self._values["runtime_state"] = "", STOPPED
        if self._script and self._seen is not None:
            asked = np.array([self._values[f"input_double_register_{24 + k}"] for k in range(6)])
            share = PERIOD_S / max(self._faults.lag_s, PERIOD_S)
            target = self._target + share * (asked - self._target)
        else:
            fastest = np.abs(self._speed).max()
            speed = self._speed * max(0.0, 1 - (self._brake if fastest else 0) * PERIOD_S / max(fastest, 1e-9))
            target = self._target + speed * PERIOD_S
        self._speed, self._target = (target - self._target) / PERIOD_S, target


class FakeUr:
    """Handle of a controller in another process."""

    def __init__(self, host: str, pipe: Connection) -> None:
        self.host, self._pipe = host, pipe

    def state(self, safety_mode: int = NORMAL) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Set the safety mode; return joint angles, rad, and velocities, rad/s."""
        self._pipe.send(safety_mode)
        angles, velocity = self._pipe.recv()
        return angles, velocity


def serve(pipe: Connection, *args: Any) -> None:
    controller = Controller(*args)
    pipe.send("ready")
    controller.run(pipe)


@contextmanager
def fake_ur(
    host: str,
    world: mujoco.MjModel | Scene,
    start: NDArray[np.float64],
    faults: Faults | None = None,
    objects: NDArray[np.float64] | None = None,
) -> Iterator[FakeUr]:
    """Run a controller at a loopback address `host`."""
    context = multiprocessing.get_context("spawn")
    pipe, theirs = context.Pipe()
    process = context.Process(target=serve, args=(theirs, host, world, start, faults or Faults(), objects))
    process.start()
    theirs.close()
    assert pipe.recv() == "ready"
    try:
        yield FakeUr(host, pipe)
    finally:
        pipe.close()
        process.join()
