"""Places, pedestal and gripper."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hrl_comfort.config import PlaceConfig
from hrl_comfort.scene.furniture import THICKNESS_M, leg_axes
from hrl_comfort.scene.looks.shapes import Colour, Part, block, hull, turned
from hrl_comfort.scene.ur import FINGER_SPREAD_M, TOOL_LENGTH_M

BEECH: Colour = (0.76, 0.62, 0.45, 1.0)
STEEL: Colour = (0.62, 0.64, 0.66, 1.0)
DARK: Colour = (0.23, 0.25, 0.27, 1.0)
RUBBER: Colour = (0.08, 0.08, 0.09, 1.0)


def place_parts(body: str, place: PlaceConfig, floor_m: float) -> Iterator[Part]:
    """Yield a place: its top, and its legs, one on a foot or four, down to the floor.

    The body's origin is the middle of the surface, `floor_m` the height of the floor from there.
    """
    x, y = (side / 2 for side in place.size_m)
    half, low = THICKNESS_M / 2, min(x, y)
    yield block(body, BEECH, (x, y, half), (0.0, 0.0, -half), 0.4 * half)
    if place.legs == 1:
        under = -THICKNESS_M
        yield turned(body, DARK, [(under - 0.008, 0.0), (under - 0.008, 0.5 * low), (under, 0.5 * low)])
        yield turned(body, STEEL, [(floor_m + 0.02, 0.022), (under - 0.02, 0.022), (under - 0.008, 0.035)])
        foot = min(1.7 * low, 0.16)
        yield turned(
            body, DARK,
            [(floor_m, foot), (floor_m + 0.008, foot), (floor_m + 0.012, foot - 0.004), (floor_m + 0.02, 0.03),
             (floor_m + 0.05, 0.023)],
        )  # fmt: skip
    for u, v in leg_axes(place) if place.legs > 1 else ():
        leg = turned(body, STEEL, [(floor_m, 0.0), (floor_m, 0.02), (-THICKNESS_M, 0.02)])
        yield leg.placed(body, (u, v, 0.0))


def pedestal_parts(floor_m: float) -> Iterator[Part]:
    """Yield the robot's column, with a plate below and one above, that the robot stands on at height 0."""
    yield turned("pedestal", STEEL, [(floor_m + 0.02, 0.07), (-0.02, 0.07)])
    yield turned("pedestal", DARK, [(-0.02, 0.0), (-0.02, 0.08), (-0.002, 0.08), (0.0, 0.078), (0.0, 0.0)])
    yield turned(
        "pedestal", DARK, [(floor_m, 0.19), (floor_m + 0.016, 0.19), (floor_m + 0.02, 0.186), (floor_m + 0.02, 0.07)]
    )
    for angle in np.arange(8) * np.pi / 4:
        bolt = turned("pedestal", STEEL, [(0.0, 0.009), (0.008, 0.009), (0.008, 0.0)])
        yield bolt.placed("pedestal", (0.16 * np.cos(angle), 0.16 * np.sin(angle), floor_m + 0.02))


def gripper_parts() -> Iterator[Part]:
    """Yield a gripper with two fingers, as wide and as long as the one that collides."""
    body, tip = "robot/gripper", TOOL_LENGTH_M
    yield turned(body, STEEL, [(0.0, 0.032), (0.014, 0.032), (0.016, 0.030), (0.016, 0.0)])
    yield block(body, DARK, (0.036, 0.024, 0.042), (0.0, 0.0, 0.058), 0.010)
    yield block(body, (0.42, 0.60, 0.74, 1.0), (0.0365, 0.0245, 0.003), (0.0, 0.0, 0.026), 0.002)
    for side in (-1.0, 1.0):
        for y in (-0.014, 0.014):
            yield hull(body, STEEL, [(0.022 * side, y, 0.092), (1.25 * FINGER_SPREAD_M * side, y, 0.132)], 0.006)
        knuckle, inner = 1.25 * FINGER_SPREAD_M * side, FINGER_SPREAD_M * side
        yield hull(
            body,
            DARK,
            [(knuckle, y, 0.130) for y in (-0.014, 0.014)] + [(inner, y, 0.158) for y in (-0.010, 0.010)],
            0.007,
        )
        yield hull(body, DARK, [(inner, y, z) for y in (-0.010, 0.010) for z in (0.155, tip - 0.004)], 0.0065)
        yield block(body, RUBBER, (0.0015, 0.010, 0.016), (inner - 0.0065 * side, 0.0, tip - 0.015), 0.001)
