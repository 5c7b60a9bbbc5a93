"""A person with a smooth body: parts of the limbs of `scene.human`, each in the frame of its limb."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hrl_comfort.humans.body import FOREARM_M, HEIGHT_M, HIP_M, SHOULDER_M, UPPER_ARM_M
from hrl_comfort.scene.human import LIMBS, limbs_of_person
from hrl_comfort.scene.looks.shapes import Colour, Part, hull, loft

SKIN: Colour = (0.80, 0.60, 0.48, 1.0)
SHIRT: Colour = (0.22, 0.37, 0.56, 1.0)
OTHER_SHIRTS: tuple[Colour, ...] = ((0.62, 0.34, 0.20, 1.0), (0.28, 0.47, 0.34, 1.0))
"""Of the second and the third person."""
TROUSERS: Colour = (0.20, 0.22, 0.27, 1.0)
SHOES: Colour = (0.10, 0.10, 0.11, 1.0)
HAIR: Colour = (0.20, 0.14, 0.10, 1.0)
HAIRLINE_RAD = 0.55
"""Angle of the hair's edge with the floor, down to the back."""


def person_parts(index: int = 0) -> Iterator[Part]:
    """Yield the parts of a person, counted from 0.

    The shapes that collide are narrower across the shoulders and the hips.
    """
    if index == 0:
        yield from _first_parts()
        return
    bodies = dict(zip(LIMBS, limbs_of_person(index), strict=True))
    for part in _first_parts():
        colour = OTHER_SHIRTS[index - 1] if part.colour == SHIRT else part.colour
        yield replace(part, body=bodies[part.body], colour=colour)


def _first_parts() -> Iterator[Part]:
    yield from _trunk()
    for side, mirrored in (("left", False), ("right", True)):
        for limb, parts in (("leg", _leg()), ("upper_arm", _upper_arm()), ("forearm", _forearm())):
            for part in parts:
                yield part.placed(f"{side}_{limb}", mirrored=mirrored)


def _trunk() -> Iterator[Part]:
    """Yield shirt, belt line, neck, head and hair; the origin is the hip."""
    shoulder, top = SHOULDER_M - HIP_M, HEIGHT_M - HIP_M
    yield loft("trunk", TROUSERS, [
        (-0.10, 0.00, 0.03, 0.06), (-0.07, 0.00, 0.09, 0.12), (0.00, -0.005, 0.115, 0.165),
        (0.08, 0.00, 0.105, 0.155), (0.12, 0.00, 0.10, 0.145),
    ], power=2.4)  # fmt: skip
    yield loft("trunk", SHIRT, [
        (0.035, 0.00, 0.120, 0.172), (0.13, 0.00, 0.112, 0.157), (0.22, 0.01, 0.108, 0.152),
        (0.34, 0.012, 0.118, 0.172),
        (0.42, 0.005, 0.113, 0.192), (shoulder - 0.02, -0.005, 0.094, 0.200), (shoulder + 0.015, -0.010, 0.076, 0.192),
        (shoulder + 0.038, -0.013, 0.062, 0.155), (shoulder + 0.058, -0.015, 0.056, 0.090),
        (shoulder + 0.075, -0.015, 0.050, 0.055),
    ], power=2.4)  # fmt: skip
    yield loft("trunk", SKIN, [
        (shoulder + 0.01, -0.015, 0.052, 0.056), (shoulder + 0.07, -0.008, 0.052, 0.054),
        (shoulder + 0.12, 0.0, 0.052, 0.052),
    ])  # fmt: skip
    yield loft("trunk", SKIN, [
        (top - 0.235, 0.030, 0.020, 0.022), (top - 0.225, 0.028, 0.048, 0.042), (top - 0.19, 0.018, 0.078, 0.058),
        (top - 0.13, 0.008, 0.092, 0.072), (top - 0.08, 0.003, 0.094, 0.075), (top - 0.04, 0.0, 0.077, 0.062),
        (top - 0.015, 0.0, 0.045, 0.037), (top - 0.006, 0.0, 0.012, 0.01),
    ])  # fmt: skip
    yield hull("trunk", SKIN, [(0.094, 0, top - 0.105), (0.106, 0, top - 0.135), (0.094, 0.006, top - 0.137),
                               (0.094, -0.006, top - 0.137)], 0.007)  # fmt: skip
    for side in (-1, 1):
        yield hull("trunk", SKIN, [(-0.006, 0.072 * side, top - 0.145), (-0.016, 0.078 * side, top - 0.105)], 0.008)
    hair = loft("trunk", HAIR, [
        (-0.015, 0.0, 0.103, 0.084), (0.02, 0.0, 0.102, 0.083), (0.06, 0.0, 0.086, 0.071), (0.085, 0.0, 0.061, 0.051),
        (0.099, 0.0, 0.030, 0.024), (0.103, 0.0, 0.006, 0.005),
    ])  # fmt: skip
    cos, sin = np.cos(HAIRLINE_RAD), np.sin(HAIRLINE_RAD)
    tilted = hair.vertices @ np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    yield replace(hair, vertices=tilted).placed("trunk", (-0.004, 0.0, top - 0.095))


def _leg() -> Iterator[Part]:
    """Yield trouser leg and shoe; the origin is the hip, the floor at -HIP_M."""
    yield loft("", TROUSERS, [
        (-HIP_M + 0.045, -0.005, 0.050, 0.047), (-HIP_M + 0.09, -0.01, 0.053, 0.049),
        (-HIP_M + 0.28, -0.018, 0.062, 0.058),
        (-HIP_M + 0.46, 0.0, 0.064, 0.060), (-0.25, 0.008, 0.080, 0.076), (-0.08, 0.0, 0.094, 0.084),
        (0.02, 0.0, 0.088, 0.078),
        (0.07, 0.0, 0.05, 0.045),
    ], power=2.2)  # fmt: skip
    sole, toe = -HIP_M + 0.022, -HIP_M + 0.026
    yield hull("", SHOES, [
        (-0.055, 0.018, sole), (-0.055, -0.018, sole), (0.13, 0.024, sole), (0.13, -0.024, sole), (0.165, 0.0, toe),
        (-0.045, 0.014, sole + 0.05), (-0.045, -0.014, sole + 0.05), (0.035, 0.016, sole + 0.05),
        (0.035, -0.016, sole + 0.05),
    ], 0.022)  # fmt: skip


def _upper_arm() -> Iterator[Part]:
    """Yield sleeve and skin; the origin is the shoulder."""
    yield loft("", SHIRT, [
        (-0.20, 0.0, 0.049, 0.049), (-0.16, 0.0, 0.050, 0.049), (-0.06, 0.0, 0.053, 0.050), (-0.015, 0.0, 0.053, 0.048),
        (0.012, 0.0, 0.046, 0.042), (0.028, 0.0, 0.030, 0.027), (0.034, 0.0, 0.008, 0.008),
    ])  # fmt: skip
    yield loft("", SKIN, [
        (-UPPER_ARM_M - 0.038, 0.0, 0.015, 0.015), (-UPPER_ARM_M - 0.02, 0.0, 0.034, 0.033),
        (-UPPER_ARM_M, 0.0, 0.040, 0.038),
        (-0.22, 0.0, 0.042, 0.041), (-0.18, 0.0, 0.043, 0.042),
    ])  # fmt: skip


def _forearm() -> Iterator[Part]:
    """Yield skin and a hand, half closed; the origin is the elbow, the fist's centre at -FOREARM_M."""
    wrist = -FOREARM_M + 0.055
    yield loft("", SKIN, [
        (wrist - 0.01, 0.0, 0.026, 0.022), (wrist + 0.02, 0.0, 0.028, 0.023), (-0.10, 0.0, 0.040, 0.037),
        (-0.04, 0.0, 0.042, 0.039),
        (0.0, 0.0, 0.039, 0.037), (0.025, 0.0, 0.029, 0.028), (0.038, 0.0, 0.010, 0.010),
    ])  # fmt: skip
    palm = -FOREARM_M + 0.03 - np.array([0.0, 0.04, 0.075])
    yield hull("", SKIN, [(-0.026, 0, palm[0]), (0.026, 0, palm[0]), (-0.024, 0, palm[1]), (0.028, 0, palm[1])], 0.016)
    for finger in (-0.028, -0.010, 0.008, 0.026):
        reach = palm[2] - 0.012 * (abs(finger - 0.002) < 0.02)
        yield hull("", SKIN, [(finger, 0.0, palm[1]), (finger, -0.012, reach)], 0.010)
    yield hull("", SKIN, [(0.030, -0.008, palm[0] + 0.005), (0.048, -0.020, palm[1])], 0.011)
