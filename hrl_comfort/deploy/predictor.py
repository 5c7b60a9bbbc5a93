"""State of an arm beyond its measured one: its network is late, and so are the set-points that it follows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.deploy.arms import Reading

Array = NDArray[np.float64]
SPLINE_S = CONTROL_STEP_S / 2
"""Delay of the set-points between control steps behind the straight lines from one control step to the next."""


class Predictor:
    """Smith predictor: the measured state, and what a model of the servos does from its instant on.

    Policies were trained on the state at the end of a control step, before they choose the next one. The arm's newest
    state is that at the beginning of the step, less the latency. The model is that of `hrl-comfort identify`: the
    set-points arrive late, and joints follow them with a first-order lag. What it does not know is in the measured
    state.

    Args:
      lag_s: of the servos behind a ramp.
      latency_s: from a set-point until the angles that it led to are measured here, the lag left out.
      point: (J,) rad, where the set-points have stood.
    """

    def __init__(self, lag_s: float, latency_s: float, point: Array) -> None:
        self._lag_s = max(lag_s, 1e-9)
        self._ago = (CONTROL_STEP_S + SPLINE_S + latency_s) / CONTROL_STEP_S
        self._point = point
        self._known = np.tile(np.stack([point, np.zeros_like(point)]), (int(np.ceil(self._ago)) + 1, 1, 1))
        """(n, 2, J) angles, rad, and velocities, rad/s, of the model at the ends of control steps, oldest first."""

    def follow(self, point: Array) -> None:
        """Advance the model by a control step to the set-point (J,) rad."""
        ramp = (point - self._point) / CONTROL_STEP_S
        behind = ramp * self._lag_s
        behind = behind + (self._point - self._known[-1, 0] - behind) * np.exp(-CONTROL_STEP_S / self._lag_s)
        self._known = np.concatenate([self._known[1:], [[point - behind, behind / self._lag_s]]])
        self._point = point

    def ahead(self, reading: Reading) -> Reading:
        """Return the state at the end of the control step last followed, for that measured at its beginning."""
        at = len(self._known) - 1 - self._ago
        before, share = int(at), at - int(at)
        then = (1 - share) * self._known[before] + share * self._known[before + 1]
        gained = self._known[-1] - then
        return Reading(reading.angles + gained[0], reading.velocity + gained[1], reading.trouble)
