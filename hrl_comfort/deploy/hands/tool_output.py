"""A hand of two states on the tool connector of a Universal Robots arm: an output closes it, an input tells a grip.

How far its fingers are closed is not measured: it is reckoned from the time since the output changed, until they grip
or are there. None of this has been tried on hardware.
"""

from __future__ import annotations

from hrl_comfort.deploy.arms import Fingers, HandReading

OUTPUT, INPUT = 0, 0
"""Tool output that closes the hand, and tool input that is on while it grips."""
TOOL_BIT = 16
"""Bit of the first one among the digital outputs and inputs that RTDE tells."""
FINGERS_S = 0.5
"""Time after which fingers that grip nothing are there."""
SHUT = 0.5
"""Set-point of the fingers, 0 open to 1 closed, above which the output is on."""


class ToolHand:
    """State of the fingers, as far as output and input tell it, and when they did.

    Args:
      time_s: by the robot's clock.
      outputs: bits of the digital outputs; the fingers are where these say.
    """

    def __init__(self, time_s: float, outputs: int) -> None:
        self._shut = _is_on(outputs, OUTPUT)
        self._closed, self._time_s, self._until_s = float(self._shut), time_s, time_s
        self._gripped = False

    def follow(self, time_s: float, outputs: int, inputs: int) -> HandReading:
        """Take what the robot tells at a time, and return the state of the hand."""
        shut, grips = _is_on(outputs, OUTPUT), _is_on(inputs, INPUT)
        passed, self._time_s = time_s - self._time_s, time_s
        if shut != self._shut:
            self._shut, self._until_s, self._gripped = shut, time_s + FINGERS_S, False
        if shut and grips:
            self._gripped = True
        else:
            way = passed / FINGERS_S if shut else -passed / FINGERS_S
            self._closed = min(1.0, max(0.0, self._closed + way))
        lost = self._gripped and not grips
        there = lost or time_s >= self._until_s
        fingers = Fingers.GRIP if shut and grips else Fingers.THERE if there else Fingers.MOVE
        return HandReading(self._closed, fingers)


def _is_on(bits: int, number: int) -> bool:
    return bool(bits >> (TOOL_BIT + number) & 1)
