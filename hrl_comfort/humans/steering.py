"""Walking and turning within bounds of speed and acceleration."""

from __future__ import annotations

import numpy as np

from hrl_comfort.compiled import contiguous, plain
from hrl_comfort.config import CONTROL_STEP_S, HumanConfig
from hrl_comfort.humans import body, kernels
from hrl_comfort.humans.walk import Array, KeepOut, Surroundings, Walk, length

TURN_RAD_S, TURN_RAD_S2 = 1.6, 3.0
"""Largest turning rate and its largest change: a right angle takes 1.5 s, as in turns while standing (Hase and Stein,
Journal of Neurophysiology 81, 1999)."""
CARRYING = np.array([[0.30, 0.15, 1.05], [0.30, -0.15, 1.05]])
"""(2, 3) m, hands before the body, in the person's frame above the floor."""
POSTURE = body.reaching(CARRYING[None])[0]
"""Limbs (6, 3) of a person who carries something."""
SLOWEST = 0.6
STRAIGHT_M = 0.3
"""Distance from the goal below which people walk straight to it."""
CLEARANCE_M, RETREAT_S = 0.03, 0.5
"""Distance kept from the rim of a disc, and time in which people leave that margin."""


def towards(offset: Array, speed_m_s: Array | float, acceleration_m_s2: float) -> Array:
    """Return the velocity (n, 2) m/s along `offset` (n, 2) m from which braking ends at its end."""
    distance = length(offset)
    brake = acceleration_m_s2 * CONTROL_STEP_S
    arriving = np.sqrt(brake * brake + 2 * acceleration_m_s2 * distance) - brake
    return offset * (np.minimum(speed_m_s, arriving) / np.maximum(distance, 1e-9))[:, None]


def pace(config: HumanConfig, walk: Walk) -> Array:
    """Return the walking speed (n,) m/s of people whose `traits` differ: 60 to 100 % of `speed_m_s`."""
    return config.speed_m_s * (SLOWEST + (1 - SLOWEST) * walk.traits[:, 1])


def round_robot(position: Array, goal: Array, speed_m_s: Array, acceleration_m_s2: float) -> Array:
    """Return the velocity (n, 2) m/s of the shorter way round the robot from position to goal (n, 2) m."""
    bearing = bearing_of(position)
    left = (bearing_of(goal) - bearing + np.pi) % (2 * np.pi) - np.pi
    radius = length(position)
    arc = np.stack([length(goal) - radius, radius * left], axis=-1)  # outwards, anticlockwise
    cos, sin = np.cos(bearing), np.sin(bearing)
    path = np.stack([cos * arc[:, 0] - sin * arc[:, 1], sin * arc[:, 0] + cos * arc[:, 1]], axis=-1)
    straight = goal - position
    return towards(np.where(length(straight)[:, None] < STRAIGHT_M, straight, path), speed_m_s, acceleration_m_s2)


def step(walk: Walk, wanted: Array, config: HumanConfig, around: Surroundings | None) -> Array:
    """Return the position (n, 2) m after a control step whose velocity is as near to `wanted` (n, 2) m/s as it may be.

    The speed stays within `speed_m_s`, the change of velocity within `acceleration_m_s2`. People brake before the
    keep-out discs of `around`, and walk along them.
    """
    assert config.acceleration_m_s2 is not None
    if plain(walk.position, wanted):
        discs = around.keep_out if around is not None else KeepOut(np.empty((len(wanted), 0, 2)), 0.0)
        moving = contiguous(walk.position, walk.velocity, wanted, discs.centres)
        limits = float(config.speed_m_s), float(config.acceleration_m_s2)
        return kernels.step(*moving, float(discs.radius_m), CLEARANCE_M, RETREAT_S, *limits)
    if around is not None:
        wanted = beside(walk.position, wanted, around.keep_out, config.acceleration_m_s2 / 4)
    wanted = wanted * np.minimum(1.0, config.speed_m_s / np.maximum(length(wanted), 1e-9))[:, None]
    return walk.position + accelerated(walk.velocity[:, :2], wanted, config.acceleration_m_s2) * CONTROL_STEP_S


def accelerated(before: Array, wanted: Array, acceleration_m_s2: float) -> Array:
    """Return the velocity (n, 2) m/s nearest to `wanted` (n, 2) that a control step from `before` (n, 2) allows."""
    change = wanted - before
    share = np.minimum(1.0, acceleration_m_s2 * CONTROL_STEP_S / np.maximum(length(change), 1e-9))
    return np.asarray(before + change * share[:, None])


def beside(position: Array, wanted: Array, keep_out: KeepOut, acceleration_m_s2: float) -> Array:
    """Return `wanted` (n, 2) m/s turned along the discs that braking would not keep clear of."""
    offset = position[:, None] - keep_out.centres
    distance = np.maximum(length(offset), 1e-9)
    out = offset / distance[..., None]
    gap = distance - keep_out.radius_m - CLEARANCE_M
    allowed = np.sqrt(2 * acceleration_m_s2 * np.maximum(gap, 0.0)) + np.minimum(gap, 0.0) / RETREAT_S
    inwards = -(wanted[:, None] * out).sum(axis=-1)
    (turned,) = (inwards > allowed).any(axis=1).nonzero()
    if not len(turned):
        return wanted
    wanted = wanted.copy()
    wanted[turned] = _turned(wanted[turned], out[turned], allowed[turned])
    return wanted


def _turned(wanted: Array, out: Array, allowed: Array) -> Array:
    """Return `wanted` (n, 2) m/s turned along discs (n, g); `out` (n, g, 2) leads away from them."""
    for disc in range(out.shape[1]):
        away = out[:, disc]
        inwards = -(wanted * away).sum(axis=1)
        excess = np.maximum(inwards - allowed[:, disc], 0.0)
        along = np.stack([-away[:, 1], away[:, 0]], axis=-1)
        way = np.where((wanted * along).sum(axis=1) < 0, -1.0, 1.0)
        aside = np.where(inwards > 0, excess, 0.0) * way
        wanted = wanted + excess[:, None] * away + aside[:, None] * along
    return wanted


def turn(walk: Walk, wanted: Array) -> Array:
    """Return the yaw (n,) rad after a control step of turning to `wanted` (n,) rad the shorter way round."""
    if plain(walk.yaw, wanted):
        return kernels.turn(*contiguous(walk.yaw, walk.velocity[:, 2], wanted), TURN_RAD_S, TURN_RAD_S2)
    left = (wanted - walk.yaw + np.pi) % (2 * np.pi) - np.pi
    brake = TURN_RAD_S2 * CONTROL_STEP_S
    rate = np.sign(left) * np.minimum(TURN_RAD_S, np.sqrt(brake * brake + 2 * TURN_RAD_S2 * np.abs(left)) - brake)
    before = walk.velocity[:, 2]
    return walk.yaw + (before + np.clip(rate - before, -brake, brake)) * CONTROL_STEP_S


def bearing_of(vectors: Array) -> Array:
    """Return the direction (n,) rad of vectors (n, 2)."""
    return np.arctan2(vectors[:, 1], vectors[:, 0])
