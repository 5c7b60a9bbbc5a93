"""People who have touched the arm step back from it and wait, or they would stand in its way for ever."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S, HumanConfig
from hrl_comfort.humans import steering
from hrl_comfort.humans.motions import bounds
from hrl_comfort.humans.walk import KeepOut, Stride, Surroundings, Walk, length

RETREAT_STEPS, WAIT_STEPS = 100, 50
"""Control steps of a retreat, 2 s, and those at its end in which people stand."""
SPEED_M_S, ACCELERATION_M_S2 = 0.5, 2.0
"""Of a step backwards, about half a metre in all. Chosen, not measured."""
STAYING = ("adversary", "live", "recorded")
"""Motions of people who stay where they touch the arm, or do as their source says."""


def begin_retreat(walk: Walk, touching: NDArray[np.int64]) -> Walk:
    """Return `walk` with the retreats of the rows `touching` at their beginning."""
    left = walk.retreat.copy()
    left[touching] = RETREAT_STEPS
    return replace(walk, retreat=left)


def retreat(config: HumanConfig, walk: Walk, stride: Stride, around: Surroundings) -> Stride:
    """Return `stride` with the proposals of those who retreat replaced: away from the nearest point of the arm.

    They keep to the bounds of their motion on speed and acceleration, and to the keep-out discs. Their hands stay as
    they are: one that went on would press against the arm, and who presses is held and cannot step back.
    """
    (rows,) = walk.retreat.nonzero()
    if not len(rows) or config.motion in STAYING:
        return stride
    speed, acceleration = np.minimum(bounds(config), (SPEED_M_S, ACCELERATION_M_S2))
    going = walk.rows(rows)
    discs = KeepOut(around.keep_out.centres[rows], around.keep_out.radius_m)
    offset = going.position[:, None] - around.arm()[0][rows, :, :2]
    nearest = offset[np.arange(len(rows)), length(offset).argmin(axis=1)]
    away = nearest / np.maximum(length(nearest), 1e-9)[:, None]
    wanted = away * (speed * (going.retreat > WAIT_STEPS))[:, None]
    wanted = steering.beside(going.position, wanted, discs, acceleration / 4)
    velocity = steering.accelerated(going.velocity[:, :2], wanted, acceleration)
    position, yaw = stride.position.copy(), stride.yaw.copy()
    position[rows] = going.position + velocity * CONTROL_STEP_S
    yaw[rows] = steering.turn(going, going.yaw)
    kept = {name: getattr(stride, name) for name in ("limbs", "memory")}
    for name, value in kept.items():
        if value is not None:
            kept[name] = value.copy()
            kept[name][rows] = getattr(going, name)
    return replace(stride, position=position, yaw=yaw, **kept)
