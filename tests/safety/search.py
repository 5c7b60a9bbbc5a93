"""A search over people and policies that provoke an unsafe contact: `python -m tests.safety.search BOUND TRIALS`.

A trial is a person who walks towards the nearest link, aside or away, beside an arm, both at speeds that are held for a
time of the trial's own and change then. Differential evolution moves them towards the fastest approach of the arm at a
touch.
"""

from __future__ import annotations

import sys
from importlib import import_module

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution

from hrl_comfort import humans
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import HumanConfig
from hrl_comfort.files.run_config import environment
from hrl_comfort.humans import steering
from hrl_comfort.humans.motions.adversary import HANGING
from hrl_comfort.humans.walk import Stride, Surroundings, Walk, length
from hrl_comfort.safety.separation import Separation
from hrl_comfort.sim.controls import limbs_of
from hrl_comfort.sim.engine import Engine

Array = NDArray[np.float64]
ROWS, PHASES, DECISIONS, JOINTS = 64, 6, 40, 6
"""Trials side by side; phases and decisions of a trial; joints of the arm."""
NUMBERS = 3 + PHASES * (3 + JOINTS)
"""Of a trial, in [0, 1]: bearing, distance and arms of the person; of each phase then time, speed, angle and action."""
SHORTEST, LONGEST = 2, 20
"""Decisions of a phase; the last one lasts until the trial ends."""
FULL = 1.5
"""Scale of actions before they are cut off, so that joints often run at full speed."""
NEAREST_M, FARTHEST_M = 0.6, 1.6
PER_M = 10.0
"""Speed (m/s) that a distance of 1 m from a touch counts as."""
WORLD = (
    "task=pick_place", "human=adversary", "human.motion=tests.safety.search:searched", "human.bound_m=10",
    "human.keep_out_m=0", "robot.rating=collaborative", "task.terminate_on=unsafe_contact",
)  # fmt: skip
people = np.zeros((ROWS, NUMBERS))
"""The trials of which `searched` is the motion."""


def phase_of(decision: Array | int) -> Array:
    """Return the numbers (ROWS, 3 + JOINTS) of the phases in which the trials are in a decision (ROWS,)."""
    phases = people[:, 3:].reshape(ROWS, PHASES, -1)
    ends = (SHORTEST + (LONGEST - SHORTEST) * phases[..., 0]).cumsum(axis=1)
    number = (np.asarray(decision).reshape(-1, 1) >= ends[:, :-1]).sum(axis=1)
    return phases[np.arange(ROWS), number]


def searched(config: HumanConfig, walk: Walk, noise: Array, around: Surroundings) -> Stride:
    """Walk as the row's trial says, within the bounds of `config`."""
    points = around.arm()[0][..., :2] - walk.position[:, None]
    nearest = points[np.arange(ROWS), (points * points).sum(axis=-1).argmin(axis=1)]
    _, speed, angle = phase_of(walk.step // 5)[:, :3].T
    angle = (2 * angle - 1) * np.pi
    ahead = nearest / np.maximum(length(nearest), 1e-9)[:, None]
    aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)
    wanted = (np.cos(angle)[:, None] * ahead + np.sin(angle)[:, None] * aside) * (speed * config.speed_m_s)[:, None]
    return Stride(steering.step(walk, wanted, config, None), walk.yaw, walk.limbs)


def closing_speed(separation: Separation, angles: Array, velocity: Array, limbs: Array) -> Array:
    """Return the speed (N,) m/s at which the arm's point nearest to the person moves towards it."""
    apart, speeds = separation.pairs(angles, velocity, limbs)
    nearest = apart.reshape(-1, len(angles)).argmin(axis=0)
    return np.take_along_axis(speeds.reshape(-1, len(angles)), nearest[None], axis=0)[0]


def fastest(engine: Engine, trials: Array) -> tuple[Array, int]:
    """Return the fastest approach (ROWS,) m/s of the arm in each of the trials (ROWS, NUMBERS) and the unsafe ones.

    Distance from a touch counts against it.
    """
    people[:] = trials
    episodes, separation = engine.episodes, engine.episodes.separation
    episodes.rewind()
    state = engine.reset()
    bearing, distance = 2 * np.pi * trials[:, 0], NEAREST_M + (FARTHEST_M - NEAREST_M) * trials[:, 1]
    spawn = distance[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    limbs = np.where(trials[:, 2, None, None] < 0.5, HANGING, steering.POSTURE)
    walk = humans.begin(engine.episodes.config.human, spawn)
    episodes.stand(humans.Walk(**{**vars(walk), "limbs": limbs}))
    found, unsafe = np.full(ROWS, -np.inf), np.zeros(ROWS, dtype=bool)
    going = np.ones(ROWS, dtype=bool)
    going &= separation.gap(state.joint_pos.numpy(), limbs_of(engine.scene, episodes.walk)) > 0
    for decision in range(DECISIONS):
        result = engine.step(np.clip(FULL * (2 * phase_of(decision)[:, 3:] - 1), -1.0, 1.0))
        beside = episodes.plan.planned.limbs.reshape(-1, 7, 7)
        moving = [
            each.numpy().reshape(len(beside), -1) for each in (result.instants.joint_pos, result.instants.joint_vel)
        ]
        gap = separation.gap(moving[0], beside)
        speed = closing_speed(separation, *moving, beside) - PER_M * np.maximum(gap, 0.0)
        valid = result.valid.numpy() & going[:, None] & ~result.instants.contact.numpy()
        found = np.maximum(found, np.where(valid, speed.reshape(ROWS, -1), -np.inf).max(axis=1))
        unsafe |= going & (result.instants.unsafe_contact & result.valid).any(dim=1).numpy()
        going &= ~result.done.numpy()
    return found, int(unsafe.sum())


def search(trials: int, *overrides: str, seed: int = 0) -> tuple[float, int]:
    """Return the fastest approach at a touch (m/s) and the number of unsafe contacts in `trials` trials."""
    engine, unsafe = Engine(environment(compose("train", [*WORLD, *overrides])), ROWS, 0), 0

    def cost(given: Array) -> Array:
        nonlocal unsafe
        found, bad = fastest(engine, given.T)
        unsafe += bad
        return -found

    first = np.random.default_rng(seed).random((ROWS, NUMBERS))
    result = differential_evolution(
        cost, [(0.0, 1.0)] * NUMBERS, init=first, maxiter=trials // ROWS - 1, vectorized=True, updating="deferred",
        polish=False, tol=0.0, mutation=(0.3, 0.9), recombination=0.5, rng=seed,
    )  # fmt: skip
    engine.close()
    return -float(result.fun), unsafe


if __name__ == "__main__":
    for way in (["safety=none"], ["safety=ssm", "safety.bound=observed"], ["safety=ssm", "safety.bound=worst"]):
        for number in range(int(sys.argv[2])):
            speed, count = import_module("tests.safety.search").search(int(sys.argv[1]), *way, seed=number)
            print(*way, f"seed {number}: {count} unsafe of {sys.argv[1]}, fastest {speed:.3f} m/s", flush=True)
