"""A control step of people as one kernel: each moves by their motion, and is held to what they may do."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import kernel
from hrl_comfort.humans.arms import limit_arms
from hrl_comfort.humans.kernels import settle
from hrl_comfort.humans.motions.kernels import approach, arc, fetcher, patrol, random_walk, reactive, worker

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
COMPILED = ("random_walk", "arc", "approach", "patrol", "worker", "reactive", "fetcher")
"""Motions by their kind in `propose`."""


@kernel
def propose(
    kinds: Ints, numbers: Array, there: Array, facing: Array, bent: Array, kept: Array, position: Array, yaw: Array,
    spawn: Array, steps: Ints, velocity: Array, traits: Array, noise: Array, tcp: Array, discs: Array, radius_m: float,
    stations: Array, points: Array, moving: Array,
) -> None:  # fmt: skip
    """Change the places, yaws, limbs and memories that are proposed for people to what their motions say.

    Each draws one of the motions of `kinds`, indices of COMPILED, with their `numbers`; what is proposed for those of
    another kind stays. `position` to `traits` are fields of `Walk`.
    """
    who = np.empty(10)
    for m in range(len(yaw)):
        index = int(traits[m, 0] * len(kinds))
        kind, of, mine = kinds[index], numbers[index], kept[m]
        if kind < 0:
            continue
        who[0], who[1], who[2], who[8], who[9] = position[m, 0], position[m, 1], yaw[m], traits[m, 1], traits[m, 2]
        who[3], who[4], who[5] = velocity[m, 0], velocity[m, 1], velocity[m, 2]
        who[6], who[7] = spawn[m, 0], spawn[m, 1]
        x, y, heading = who[0], who[1], who[2]
        if kind == 0:
            x, y, heading = random_walk(who, of, noise[m])
        elif kind == 1:
            x, y, heading = arc(who, of, noise[m], steps[m])
        elif kind == 2:
            x, y, heading = approach(who, of, tcp[m])
        elif kind == 3:
            x, y, heading = patrol(who, of, mine, noise[m], stations[m], discs[m], radius_m)
        elif kind == 4:
            x, y, heading = worker(who, of, mine, bent[m], noise[m], stations[m], discs[m], radius_m)
        elif kind == 5:
            x, y, heading = reactive(
                who, of, mine, steps[m] == 0, noise[m], stations[m], discs[m], radius_m, tcp[m], points[m], moving[m]
            )
        elif kind == 6:
            x, y, heading = fetcher(who, of, mine, bent[m], noise[m], stations[m], discs[m], radius_m)
        there[m, 0], there[m, 1], facing[m] = x, y, heading


@kernel
def advance(
    kinds: Ints, numbers: Array, limits: Array, smoothing: float, there: Array, facing: Array, bent: Array,
    kept: Array, position: Array, yaw: Array, spawn: Array, walked_m: Array, speed_m_s: Array, steps: Ints,
    velocity: Array, limbs: Array, memory: Array, traits: Array, retreat: Ints, noise: Array, tcp: Array, discs: Array,
    radius_m: float, stations: Array, points: Array, moving: Array,
) -> tuple[Array, Array, Array, Ints, Ints]:  # fmt: skip
    """See `humans.Motions.advance`: `propose`, `settle`, whose result it returns, and `limit_arms`."""
    propose(
        kinds, numbers, there, facing, bent, kept, position, yaw, spawn, steps, velocity, traits, noise, tcp, discs,
        radius_m, stations, points, moving,
    )  # fmt: skip
    settled = settle(
        there, facing, bent, kept, limits, position, yaw, spawn, walked_m, speed_m_s, steps, velocity, limbs, memory,
        traits, retreat, discs, radius_m, points, smoothing,
    )  # fmt: skip
    limit_arms(bent, limbs, settled[0], limits, traits)
    return settled
