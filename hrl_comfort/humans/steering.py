"""Walking within bounds of speed and acceleration, and how those who carry something hold their hands."""

from __future__ import annotations

import numpy as np

from hrl_comfort.compiled import contiguous
from hrl_comfort.config import HumanConfig
from hrl_comfort.humans import body, kernels
from hrl_comfort.humans.walk import Array, KeepOut, Surroundings, Walk

CARRYING = np.array([[0.30, 0.15, 1.05], [0.30, -0.15, 1.05]])
"""(2, 3) m, hands before the body, in the person's frame above the floor."""
POSTURE = body.reaching(CARRYING[None])[0]
"""Limbs (6, 3) of a person who carries something."""
SLOWEST = 0.6
"""Share of `speed_m_s` at which the slowest people walk."""


def step(walk: Walk, wanted: Array, config: HumanConfig, around: Surroundings | None) -> Array:
    """Return the position (n, 2) m after a control step whose velocity is as near to `wanted` (n, 2) m/s as it may be.

    The speed stays within `speed_m_s`, the change of velocity within `acceleration_m_s2`. People brake before the
    keep-out discs of `around`, and walk along them.
    """
    assert config.acceleration_m_s2 is not None
    discs = around.keep_out if around is not None else KeepOut(np.empty((len(wanted), 0, 2)), 0.0)
    moving = contiguous(walk.position, walk.velocity, wanted, discs.centres)
    limits = float(config.speed_m_s), float(config.acceleration_m_s2)
    return kernels.step(*moving, float(discs.radius_m), *limits)
