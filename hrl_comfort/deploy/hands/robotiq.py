"""A Robotiq hand on a robot of Universal Robots, by the socket server of its URCap on the robot's controller.

The server takes one line of ASCII at a time, `SET POS 255` or `GET OBJ`, and answers `ack` or `OBJ 2`, with or without
an end of line; `?` stands for a value that it does not know, as in an emergency stop. Variables and codes are those of
Robotiq's 2F-85 instruction manual (registers gSTA, gOBJ, gFLT); the lines are as in dof.robotiq.com/discussion/1962
and in `robotiq_gripper.h` of SDU Robotics' ur_rtde. POS is 0 to 255, of a 2F-85 about 3 to 228. None of this has been
tried on hardware.
"""

from __future__ import annotations

import socket
import time
from contextlib import suppress

from hrl_comfort.deploy.arms import Fingers, HandReading

PORT = 63352
ANSWER_S = 2.0
"""Longest time for an answer before the arm moves."""
STALE_S = 0.25
"""Age of a request without an answer at which the connection counts as lost."""
ROUND = ("OBJ", "POS", "OBJ", "FLT", "OBJ", "POS", "OBJ", "STA")
"""Variables that are asked for in turn: every second time, whether the fingers hold something."""
HOLDING = {"OBJ": "POS", "POS": "OBJ"}
"""Variables asked for instead while they do: an object that is lost or torn out moves the fingers first."""
ACTIVE, MOST = 3, 255
"""Value of STA of a hand that has been activated; largest value of POS, SPE and FOR."""
FORCE_N = (20.0, 235.0)
"""Least and largest force of a 2F-85."""
FAULTS = {
    5: "activation has to be completed first", 7: "not activated", 8: "too hot", 9: "no communication for a second",
    10: "voltage too low", 11: "automatic release in progress", 12: "internal fault", 13: "activation failed",
    14: "overcurrent", 15: "automatic release completed",
}  # fmt: skip
"""Meaning of FLT."""


class RobotiqHand:
    """A hand that has been activated; its fingers stay where they are until they are told.

    There is one request at a time. `read` and `send` do not wait for its answer. A grip is told once the position has
    been asked for after it: the one asked for before is where the fingers were as they closed.

    Args:
      host: address of the robot's controller.
      force_n: of the grip.

    Raises:
      ConnectionError: nobody answers, the hand is not activated, or it has a fault.
    """

    def __init__(self, host: str, force_n: float) -> None:
        self._where, self._pending, self._data, self._turn = f"{host}:{PORT}", "", "", 0
        self._told = self._asked = -1
        self._values = dict.fromkeys(ROUND, 0)
        self._located = self._holding = False
        self._since_s = 0.0
        try:
            self._socket = socket.create_connection((host, PORT), ANSWER_S)
        except OSError as error:
            raise ConnectionError(
                f"the gripper's server {self._where} does not answer ({error.strerror or error}): is its URCap "
                "installed?"
            ) from error
        try:
            self._begin(force_n)
        except BaseException:
            self._socket.close()
            raise

    def _begin(self, force_n: float) -> None:
        for name in sorted(set(ROUND)):
            self._ask(f"GET {name}")
        if trouble := self._trouble():
            raise ConnectionError(f"{trouble}; put it right on the robot's pendant, where the fingers may move")
        self._told = self._asked = self._values["POS"]
        low, high = FORCE_N
        share = min(1.0, max(0.0, (force_n - low) / (high - low)))
        for name, value in {"POS": self._told, "SPE": MOST, "FOR": round(share * MOST), "GTO": 1}.items():
            self._ask(f"SET {name} {value}")
        self._socket.setblocking(False)
        self._request()

    def read(self) -> HandReading:
        """See `Hand`."""
        self._listen()
        if self._pending and (age := time.monotonic() - self._since_s) > STALE_S:
            raise ConnectionError(f"the gripper has not answered {self._pending!r} for {age:.2g} s")
        values = self._values
        fingers = Fingers(values["OBJ"]) if values["OBJ"] in list(Fingers) else Fingers.MOVE
        if fingers == Fingers.GRIP and not self._located:
            fingers = Fingers.MOVE
        return HandReading(values["POS"] / MOST, fingers, self._trouble())

    def send(self, closed: float) -> None:
        """See `Hand`; it is sent with one of the next requests."""
        self._asked = round(MOST * closed)

    def close(self) -> None:
        """See `Hand`."""
        with suppress(OSError):
            self._socket.close()

    def _trouble(self) -> str:
        """Return why the fingers do not follow."""
        status, fault = self._values["STA"], self._values["FLT"]
        if fault:
            return f"the gripper has fault {fault} ({FAULTS.get(fault, 'unknown')})"
        return "" if status == ACTIVE else f"the gripper is not activated (STA {status}, not {ACTIVE})"

    def _listen(self) -> None:
        """Take an answer that has come, and make the next request; one a call, whatever has come."""
        try:
            said = self._socket.recv(1024)
        except BlockingIOError:
            return
        except OSError as error:
            raise ConnectionError(f"the gripper's server has gone ({error.strerror or error})") from error
        if not said:
            raise ConnectionError("the gripper's server has closed the connection")
        if self._answered(said):
            self._request()

    def _request(self) -> None:
        """Ask where the fingers grip, send a new set-point unless the latest request did, or ask on."""
        if self._values["OBJ"] == Fingers.GRIP and not self._located:
            self._send("GET POS")
            return
        if self._asked != self._told and not self._pending.startswith("SET"):
            self._send(f"SET POS {self._asked}")
            self._told, self._holding = self._asked, False
            return
        name = ROUND[self._turn % len(ROUND)]
        self._send(f"GET {HOLDING.get(name, name) if self._holding else name}")
        self._turn += 1

    def _send(self, line: str) -> None:
        self._pending, self._since_s = line, time.monotonic()
        try:
            self._socket.sendall(f"{line}\n".encode())
        except OSError as error:
            raise ConnectionError(f"the gripper's server has gone ({error.strerror or error})") from error

    def _ask(self, line: str) -> int:
        """Return the answer to a line, 0 to SET; wait for it."""
        self._send(line)
        name = line.split()[1]
        try:
            while not self._answered(said := self._socket.recv(1024)):
                if not said:
                    raise ConnectionError("the gripper's server has closed the connection")
        except TimeoutError:
            raise ConnectionError(
                f"the gripper's server {self._where} has not answered {line!r} for {ANSWER_S:g} s"
            ) from None
        return self._values[name] if line.startswith("GET") else 0

    def _answered(self, said: bytes) -> bool:
        """Take a part of an answer; return whether it is complete.

        Raises:
          ConnectionError: it answers something else.
        """
        self._data += said.decode(errors="replace")
        kind, name, *_ = self._pending.split()
        words, whole = self._data.split(), ["ack"] if kind == "SET" else [name]
        if words[:1] != whole and not whole[0].startswith(self._data.strip()):
            raise ConnectionError(f"the gripper answers {self._data.strip()!r} to {self._pending!r}")
        if len(words) < (1 if kind == "SET" else 2) or words[:1] != whole:
            return False
        if kind == "GET":
            self._values[name] = self._number(words[1])
            if name in ("OBJ", "POS"):
                gripped = self._values["OBJ"] == Fingers.GRIP
                self._located = gripped and (self._located or name == "POS")
                self._holding |= self._located
        self._data = ""
        return True

    def _number(self, word: str) -> int:
        try:
            return int(word)
        except ValueError:
            raise ConnectionError(
                f"the gripper answers {word!r} to {self._pending!r}: is the robot in an emergency stop?"
            ) from None
