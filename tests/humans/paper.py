"""The authors' scene as the tests of people need it: spawns, goals and a person there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hrl_comfort import humans
from hrl_comfort.config import HumanConfig

GOALS = np.array([[-0.615, -0.070], [0.647, -0.055], [0.126, 0.453]])

# The authors' scene, reference code of 10.1109/ACCESS.2024.3451663.
SPAWNS = [
    [0.18, -0.64], [0.49, 0.22], [-0.30, 0.28], [0.10, 0.73], [-0.44, -0.35], [-0.17, -0.62], [1.00, -0.66],
    [0.55, -0.39], [-0.28, 0.28], [0.49, 0.29], [0.10, 0.73], [0.60, -0.55], [0.10, -0.54], [-0.42, 0.28],
    [0.74, 0.56], [-0.53, 0.35], [-0.28, -0.66], [-0.91, 0.13], [0.20, -0.72],
]  # fmt: skip

HUMAN = HumanConfig(
    motion="random_walk", spawns_m=SPAWNS, held_out=[3, 5, 7, 10, 11, 14, 16, 17], spawn="points",
    spawn_jitter_m=0.1, spawn_radius_m=[0.38, 1.1], spawn_margin_m=0.1, keep_out_m=0.35, bound_m=0.5,
    jitter_m=0.015, forward_m=0.008, forward_probability=0.02, arc_deg=30.0, arc_steps=500, speed_m_s=0.5,
    acceleration_m_s2=None, curiosity=0.5, mixture={}, others={}, partitioned=False, file=None, clipping="off",
    stations_m=None, stay_s=4.0,
)  # fmt: skip


def human(motion: str, **changes: object) -> HumanConfig:
    return replace(HUMAN, motion=motion, **changes)


def discs(rows: int) -> humans.KeepOut:
    return humans.around(GOALS, HUMAN.keep_out_m, rows)


def no_discs(rows: int) -> humans.KeepOut:
    return humans.KeepOut(np.zeros((rows, 0, 2)), 0.35)
