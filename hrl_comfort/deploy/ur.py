"""Arms of Universal Robots: state by RTDE, set-points by RTDE input registers that a short URScript follows.

A hand on the tool connector is one of the set-points: the script switches the tool's output.

The controller runs the script, so nothing has to be installed on it; it must be in remote control. Two guards stop an
arm whose runner is dead: the script brakes once the counter has not changed for STALE_S, and the controller's own
watchdog ends the program after 100 ms. RTDE guide and URScript manual: Universal Robots.
"""

from __future__ import annotations

import secrets
import socket
import struct
import time
from contextlib import suppress

import numpy as np

from hrl_comfort.config import ConfigError
from hrl_comfort.deploy.arms import PERIOD_S, Array, Reading
from hrl_comfort.deploy.hands.tool_output import OUTPUT, SHUT, ToolHand

RTDE_PORT, SCRIPT_PORT = 30004, 30002
ANSWER_S = 5.0
"""Longest time for an answer of the controller, and for the start of the script."""
STALE_S = 0.05
"""Age of the newest state, or of the newest set-point, at which the connection counts as lost."""
FIRST = 24
"""First of the registers: three integers, the counter, negative at the end, the number of the program that the
set-points are for, and 1 to close a hand on the tool connector; and six floats, the set-point, rad."""
VARIABLES = ["timestamp", "actual_q", "actual_qd", "robot_mode", "safety_mode", "runtime_state"]
BITS = ["actual_digital_output_bits", "actual_digital_input_bits"]
"""Further variables with a hand on the tool connector."""
RUNNING, PLAYING = 7, 2
"""Robot mode and runtime state."""
SAFE = (1, 2)
"""Safety modes in which the arm moves: normal, reduced."""
SAFETY_MODES = {
    3: "protective stop", 4: "recovery", 5: "safeguard stop", 6: "emergency stop", 7: "emergency stop",
    8: "violation", 9: "fault", 10: "joint not validated", 11: "safety mode undefined", 12: "safeguard stop",
    13: "safeguard stop",
}  # fmt: skip
"""Name of each safety mode in which the arm stands."""


def script(number: int, acceleration_rad_s2: float, hand: bool = False) -> str:
    """Return the program `number` of the controller; it brakes with the acceleration when set-points cease.

    Registers keep what an earlier program was told, so it waits until they hold set-points for its own number. `hand`:
    it switches the output of the tool, when that is to change.
    """
    switch = f"""    if read_input_integer_register({FIRST + 2}) != shut:
      shut = read_input_integer_register({FIRST + 2})
      set_tool_digital_out({OUTPUT}, shut == 1)
    end
"""
    joints = ", ".join(f"read_input_float_register({FIRST + k})" for k in range(6))
    return f"""def hrl_comfort():
  rtde_set_watchdog("input_int_register_{FIRST}", 10, "stop")
  while read_input_integer_register({FIRST + 1}) != {number}:
    sync()
  end
  shut = -1
  stale = 0
  count = read_input_integer_register({FIRST})
  last = count
  while (count >= 0) and (stale < {round(STALE_S / PERIOD_S)}):
    servoj([{joints}], 0, 0, {PERIOD_S}, 0.03, 500)
{switch if hand else ""}    last = count
    count = read_input_integer_register({FIRST})
    if count == last:
      stale = stale + 1
    else:
      stale = 0
    end
  end
  stopj({acceleration_rad_s2:.3f})
end
"""


class Registers:
    """Input registers of a controller, written at once: three integers and six floats (RTDE, protocol version 2).

    Args:
      host: address of the controller.
      number: of the program that they are for.

    Raises:
      ConnectionError: the controller does not answer, or does not grant them.
    """

    def __init__(self, host: str, number: int) -> None:
        self._number = number
        self._socket = _rtde(host)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sizes = {"int": 3, "double": 6}
        names = [f"input_{kind}_register_{FIRST + k}" for kind, size in sizes.items() for k in range(size)]
        granted = _ask(self._socket, b"I", ",".join(names).encode())
        if granted[0] == 0 or b"IN_USE" in granted or b"NOT_FOUND" in granted:
            raise ConnectionError(f"{host} does not grant the registers from {FIRST} on: {granted[1:].decode()}")
        self._recipe = granted[:1]
        if _ask(self._socket, b"S", b"") != b"\x01":
            raise ConnectionError(f"{host} does not start RTDE")
        self._socket.settimeout(STALE_S)

    def write(self, count: int, angles: Array, shut: bool) -> None:
        """Write the counter and the set-point: (6,) rad, and whether the hand closes."""
        values = struct.pack(">3i6d", count, self._number, shut, *angles)
        try:
            self._socket.sendall(_package(b"U", self._recipe + values))
        except OSError as error:
            raise ConnectionError(f"set-points cannot be sent ({error.strerror or error})") from error

    def close(self) -> None:
        """End the connection."""
        self._socket.close()


class UrArm:
    """The arm of a controller.

    Args:
      host: address of the controller.
      acceleration_rad_s2: with which its script brakes when set-points cease.
      hand: there is a hand on its tool connector.

    Raises:
      ConfigError: ur_rtde is not installed.
      ConnectionError: there is no controller, or it is not ready to move.
    """

    def __init__(self, host: str, acceleration_rad_s2: float, hand: bool = False) -> None:
        try:
            from rtde_receive import RTDEReceiveInterface
        except ImportError as error:
            raise ConfigError("connection=ur needs ur_rtde: pip install 'hrl-comfort[ur]'") from error
        _rtde(host).close()  # ur_rtde would wait for ever where nobody answers
        try:
            self._receiver = RTDEReceiveInterface(host, 1 / PERIOD_S, VARIABLES + BITS * hand)
        except RuntimeError as error:
            raise ConnectionError(f"{host} does not send its state: {' '.join(str(error).split())}") from error
        self._stamp, self._since_s, self._playing = -1.0, time.monotonic(), False
        self._hand = ToolHand(*self._told_of_hand()[:2]) if hand else None
        reading = self.read()
        if reading.trouble:
            raise ConnectionError(f"{host} is not ready: {reading.trouble}")
        if self._receiver.getRuntimeState() == PLAYING:
            raise ConnectionError(f"a program runs on {host}: stop it first")
        here = reading.angles if reading.hand is None else np.append(reading.angles, reading.hand.closed)
        number, self._count, self._shut = secrets.randbelow(2**31 - 1) + 1, 0, False
        self._registers = Registers(host, number)
        with _connect(host, SCRIPT_PORT) as sender:
            sender.sendall(script(number, acceleration_rad_s2, hand).encode())
            deadline = time.monotonic() + ANSWER_S
            while not self._playing:  # the arm stands until then: its state may be late
                self.send(here)
                self._playing = self._receiver.getRuntimeState() == PLAYING
                if not self._playing and time.monotonic() > deadline:
                    self.read()  # says so if it is the robot's state that is missing
                    raise ConnectionError(f"{host} does not run the script: is it in remote control?")
                time.sleep(PERIOD_S)

    def read(self) -> Reading:
        """See `Arm`."""
        receiver, now = self._receiver, time.monotonic()
        if (stamp := receiver.getTimestamp()) != self._stamp:
            self._stamp, self._since_s = stamp, now
        elif now - self._since_s > STALE_S:
            raise ConnectionError(f"no state of the robot for {now - self._since_s:.2g} s")
        mode, safety = receiver.getRobotMode(), receiver.getSafetyMode()
        trouble = "" if safety in SAFE else SAFETY_MODES.get(safety, f"safety mode {safety}")
        if not trouble and mode != RUNNING:
            trouble = f"robot mode {mode}, not {RUNNING} (running)"
        if not trouble and self._playing and receiver.getRuntimeState() != PLAYING:
            trouble = "the program on the robot has ended"
        there = None if self._hand is None else self._hand.follow(*self._told_of_hand())
        return Reading(np.array(receiver.getActualQ()), np.array(receiver.getActualQd()), trouble, there)

    def _told_of_hand(self) -> tuple[float, int, int]:
        """Return the robot's time, s, and the bits of its digital outputs and inputs."""
        receiver = self._receiver
        return (
            receiver.getTimestamp(), receiver.getActualDigitalOutputBits(), receiver.getActualDigitalInputBits()
        )  # fmt: skip

    def send(self, angles: Array) -> None:
        """See `Arm`."""
        self._count += 1
        self._shut = self._hand is not None and bool(angles[6] > SHUT)
        self._registers.write(self._count, angles[:6], self._shut)

    def lay(self, objects: Array) -> None:
        """See `Arm`."""

    def close(self) -> None:
        """See `Arm`; the script ends, and the controller holds the arm."""
        with suppress(ConnectionError):
            self._registers.write(-1, np.array(self._receiver.getActualQ()), self._shut)
        self._registers.close()
        self._receiver.disconnect()


def _connect(host: str, port: int) -> socket.socket:
    try:
        return socket.create_connection((host, port), ANSWER_S)
    except OSError as error:
        raise ConnectionError(f"{host}:{port} does not answer ({error.strerror or error})") from error


def _rtde(host: str) -> socket.socket:
    """Return a connection that speaks version 2 of RTDE; raise ConnectionError where the controller does not."""
    connection = _connect(host, RTDE_PORT)
    if _ask(connection, b"V", struct.pack(">H", 2)) != b"\x01":
        raise ConnectionError(f"{host} does not know version 2 of RTDE")
    return connection


def _ask(connection: socket.socket, kind: bytes, payload: bytes) -> bytes:
    """Return the answer to a request, messages of other kinds left out."""
    deadline = time.monotonic() + ANSWER_S
    connection.sendall(_package(kind, payload))
    while time.monotonic() < deadline:
        size, answered = struct.unpack(">Hc", _receive(connection, 3))
        content = _receive(connection, size - 3)
        if answered == kind:
            return content
    raise ConnectionError(f"the controller has not answered by RTDE for {ANSWER_S:g} s")


def _receive(connection: socket.socket, size: int) -> bytes:
    found = b""
    while len(found) < size:
        try:
            part = connection.recv(size - len(found))
        except TimeoutError:
            raise ConnectionError(f"the controller has not answered by RTDE for {ANSWER_S:g} s") from None
        if not part:
            raise ConnectionError("the controller has closed RTDE")
        found += part
    return found


def _package(kind: bytes, payload: bytes) -> bytes:
    return struct.pack(">Hc", 3 + len(payload), kind) + payload
