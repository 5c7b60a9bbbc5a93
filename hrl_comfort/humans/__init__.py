"""Human motions, spawn points and the human position in observations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import contiguous
from hrl_comfort.config import FAR_AWAY_M, ConfigError, HumanConfig
from hrl_comfort.humans.evaluation import (
    MOTION_STREAM,
    EvaluationSet,
    drawn_set,
    load_evaluation_set,
    persons_of,
    share_of,
    split_set,
)
from hrl_comfort.humans.kernels import RETREAT_SPEED
from hrl_comfort.humans.motions import CARRIERS, MOTIONS, STEERED, UNBOUNDED, Compiled, bounds, free, motion, step
from hrl_comfort.humans.motions.kernels import other_stays
from hrl_comfort.humans.motions.live import pose_source
from hrl_comfort.humans.motions.none import none
from hrl_comfort.humans.motions.recorded import pose_at
from hrl_comfort.humans.retreat import retreat_limits
from hrl_comfort.humans.steering import POSTURE
from hrl_comfort.humans.walk import (
    MEMORY,
    NOISE,
    SPEED_SMOOTHING,
    TRAITS,
    ArmSource,
    Array,
    KeepOut,
    Stride,
    Surroundings,
    Walk,
    facing_base,
    gait,
    habits,
    length,
    outside,
)

MAX_SPAWN_DRAWS = 1000
SPAWN_TRIES, SPAWN_ROUNDS = 50, 10
"""Draws of the start of one of several people before all are drawn anew, and how often they are at each of APART_M."""
APART_M = (0.6, 0.45, 0.3)
"""Smallest distance between people where an episode begins; the next is for where there is no room for the one before.
Nothing keeps people apart afterwards."""


def begin(config: HumanConfig, spawn: Array, traits: Array | None = None) -> Walk:
    """Return n humans at `spawn` (n, 2) m, facing the robot; `traits` (n, TRAITS) are 0 by default.

    Motion `none` puts them far away, `recorded` where its file says.
    """
    n = len(spawn)
    traits = np.zeros((n, TRAITS)) if traits is None else traits
    position, yaw, limbs = spawn.copy(), facing_base(spawn), np.full((n, 6, 3), np.nan)
    for rows, member in _members(config, traits):
        if member.motion == "recorded":
            stride = pose_at(member, spawn[rows], traits[rows], np.zeros(len(rows), dtype=np.int64))
            position[rows], yaw[rows], limbs[rows] = stride.position, stride.yaw, stride.limbs
        elif member.motion == "live":
            source = pose_source(member.file)  # one that cannot be opened is refused before the first step
            if member.file is not None and (pose := source()) is not None:
                position[rows] = pose[:2]
                yaw[rows] = yaw[rows] if pose[2] is None else pose[2]
        elif member.motion in CARRIERS and member.acceleration_m_s2 is not None:
            limbs[rows] = POSTURE
        elif motion(member.motion) is none:
            position[rows], yaw[rows] = (FAR_AWAY_M, 0.0), 0.0
    still, steps = np.zeros(n), np.zeros(n, dtype=np.int64)
    memory = np.zeros((n, MEMORY))
    return Walk(
        position, yaw, spawn.copy(), still, still, steps, np.zeros((n, 3)), limbs, memory, traits.copy(), steps.copy()
    )


def _members(config: HumanConfig, traits: Array) -> list[tuple[NDArray[np.int64], HumanConfig]]:
    """Return the rows of each motion of a mixture and its configuration; of another motion all rows."""
    if not config.mixture:
        return [(np.arange(len(traits)), config)]
    chosen = (traits[:, 0] * len(config.people)).astype(np.int64)
    found = [(np.flatnonzero(chosen == index), member) for index, member in enumerate(config.people)]
    return [(rows, member) for rows, member in found if len(rows)]


class Motions:
    """Motion of people, who each draw one of a mixture if there is one."""

    def __init__(self, config: HumanConfig) -> None:
        self._members = config.people if config.mixture else [config]
        self._compiled = Compiled(self._members)
        self._limits = np.array([
            (float(free(each)), each.bound_m, *retreat_limits(each)) for each in self._members
        ])  # fmt: skip
        self._others = [
            (index, each, motion(each.motion))
            for index, each in enumerate(self._members) if each.motion not in step.COMPILED
        ]  # fmt: skip

    def leaves(self, walk: Walk) -> NDArray[np.bool_]:
        """Return (n,) whether people leave an arm that they touch."""
        member = (walk.traits[:, 0] * len(self._members)).astype(np.int64)
        return np.asarray(self._limits[member, RETREAT_SPEED] > 0.0)

    def advance(self, walk: Walk, noise: Array, seen: Surroundings) -> Walk:
        """Return the walk after one control step (20 ms); noise (n, NOISE) in [0, 1).

        A step beyond `bound_m` from the spawn ends at that distance. A step into a keep-out disc slides along its rim.
        The human stays in place if the slide ends in another disc or beyond `bound_m`. Motions that are `free` keep to
        neither.
        """
        there, facing, bent, kept = proposed = walk.proposed()
        for index, member, move in self._others:
            rows: Any = slice(None)
            if len(self._members) > 1:
                rows = np.flatnonzero((walk.traits[:, 0] * len(self._members)).astype(np.int64) == index)
                if not len(rows):
                    continue
            moved = move(member, walk.part(rows), noise[rows], seen.part(rows))
            stride = moved if isinstance(moved, Stride) else Stride(*moved)
            there[rows], facing[rows] = stride.position, stride.yaw
            if stride.limbs is not None:
                bent[rows] = stride.limbs
            if stride.memory is not None:
                kept[rows] = stride.memory
        velocity, walked, speed, steps, left = step.advance(
            *self._compiled.motions, self._limits, SPEED_SMOOTHING, *proposed, *contiguous(*vars(walk).values()),
            *self._compiled.beside(walk, noise, seen),
        )  # fmt: skip
        return Walk(there, facing, walk.spawn, walked, speed, steps, velocity, bent, kept, walk.traits, left)


def advance(config: HumanConfig, walk: Walk, noise: Array, seen: Surroundings) -> Walk:
    """See `Motions.advance`."""
    return Motions(config).advance(walk, noise, seen)


def with_other_stays(config: HumanConfig, walk: Walk, uniform: Array) -> Walk:
    """Return a walk (n) in which people stay at stations as long as others might who look alike.

    Other motions draw nothing ahead. uniform (n,) in [0, 1).
    """
    memory = walk.memory.copy()
    for rows, member in _members(config, walk.traits):
        if member.motion == "fetcher":
            memory[rows] = other_stays(memory[rows], member.stay_s, uniform[rows])
    return replace(walk, memory=memory)


def moved_spawns(config: HumanConfig, goals: Array) -> Array:
    """Return the spawn points (s, 2) m; those within `keep_out_m` of a goal (g, 2) m or the base are moved out."""
    spawns = np.array(config.spawns_m, dtype=np.float64)
    return outside(spawns, around(goals, config.keep_out_m, len(spawns)))


def around(goals: Array, radius_m: float, rows: int) -> KeepOut:
    """Return discs around the goals (g, 2) m and the robot's base, repeated for each row."""
    centres = np.vstack([goals, np.zeros((1, 2))])
    return KeepOut(np.broadcast_to(centres, (rows, *centres.shape)), radius_m)


def training_spawns(config: HumanConfig) -> NDArray[np.int64]:
    """Return the indices of the spawn points that are not held out."""
    held_out = set(config.held_out)
    return np.array([i for i in range(len(config.spawns_m)) if i not in held_out], dtype=np.int64)


def jittered_spawn(config: HumanConfig, spawn: Array, uniform: Array) -> Array:
    """Return `spawn` (n, 2) m displaced uniformly in a disc of radius `spawn_jitter_m`; uniform (n, 2) in [0, 1)."""
    radius = config.spawn_jitter_m * np.sqrt(uniform[:, :1])
    angle = 2 * np.pi * uniform[:, 1]
    return spawn + radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def training_spawn(
    config: HumanConfig,
    spawns: Array,
    keep_out: KeepOut,
    rng: np.random.Generator,
) -> tuple[int, Array]:
    """Draw a training spawn as `config.spawn` says: index into `spawns` (-1: anywhere) and position (2,) m.

    The position lies outside the keep-out discs and at least `spawn_margin_m` from held-out `spawns` (s, 2) m.

    Raises:
      ConfigError: no free position in MAX_SPAWN_DRAWS draws.
    """
    held_out = spawns[list(config.held_out)]
    nearest, farthest = config.spawn_radius_m
    at_point = config.spawn == "points" or (config.spawn == "mixed" and rng.random() < 0.5)
    indices = training_spawns(config) if at_point else np.empty(0, dtype=np.int64)
    for _ in range(MAX_SPAWN_DRAWS):
        index = -1
        if at_point:
            index = int(indices[rng.integers(len(indices))])
            place = outside(jittered_spawn(config, spawns[index][None], rng.random((1, 2))), keep_out)[0]
        else:
            radius, bearing = rng.uniform(nearest, farthest), rng.uniform(-np.pi, np.pi)
            place = radius * np.array([np.cos(bearing), np.sin(bearing)])
        clear = (np.linalg.norm(held_out - place, axis=-1) >= config.spawn_margin_m).all()
        if clear and not keep_out.entered(place[None])[0]:
            return index, place
    raise ConfigError(
        f"human.spawn_radius_m={list(config.spawn_radius_m)} holds no free spawn; "
        "widen it, or lower human.keep_out_m or human.spawn_margin_m"
    )


def spawns_apart(
    people: Sequence[HumanConfig],
    spawns: Sequence[Array],
    keep_out: KeepOut,
    rngs: Sequence[np.random.Generator],
    first: Array,
) -> Array:
    """Draw training spawns of the others as `training_spawn` does, APART_M from the `first` (2,) m and each other.

    `people` and their `spawns` (s, 2) m are those of everybody, `keep_out` says where the discs are, and `rngs` are
    those of the others. Return the places (P, 2) m of everybody.

    Raises:
      ConfigError: no room was found for them.
    """
    if len(people) == 1:
        return first[None]
    others = [(person, KeepOut(keep_out.centres, person.keep_out_m)) for person in people[1:]]
    for apart_m in np.repeat(APART_M, SPAWN_ROUNDS):
        taken = [first]
        for (person, discs), own, rng in zip(others, spawns[1:], rngs, strict=True):
            for _ in range(SPAWN_TRIES):
                _, place = training_spawn(person, own, discs, rng)
                if all(length(place - each) >= apart_m for each in taken):
                    taken.append(place)
                    break
            else:
                break  # those before may stand in the way
        if len(taken) == len(people):
            return np.stack(taken)
    raise ConfigError(
        f"human.spawn_radius_m={list(people[0].spawn_radius_m)} has no room for {len(people)} people {APART_M[-1]} m "
        "apart; widen it, or give fewer human.others"
    )


def seen_position(config: HumanConfig, position: Array, spawns: Array) -> Array:
    """Return the human position (n, 2) m in the observation for true positions (n, 2) m.

    Motion `none` gives a position far away. `clipping=full` gives the nearest spawn point;
    `partial` gives that point only if it is nearer to the robot than the human. The paper's "a given point
    nearer than the human" does not say nearer to what. This reading never reports a human as farther away.
    """
    if config.motion == "none":
        return np.tile([FAR_AWAY_M, 0.0], (len(position), 1))
    if config.clipping == "off":
        return position
    nearest = spawns[np.linalg.norm(position[:, None] - spawns[None], axis=-1).argmin(axis=1)]
    if config.clipping == "full":
        return nearest
    nearer = np.linalg.norm(nearest, axis=-1) < np.linalg.norm(position, axis=-1)
    return np.where(nearer[:, None], nearest, position)


__all__ = [
    "MOTIONS", "MOTION_STREAM", "NOISE", "STEERED", "TRAITS", "UNBOUNDED", "ArmSource", "EvaluationSet", "KeepOut",
    "Motions", "Surroundings", "Walk", "advance", "around", "begin", "bounds", "drawn_set", "free", "gait", "habits",
    "jittered_spawn", "load_evaluation_set", "motion", "moved_spawns", "outside", "persons_of", "seen_position",
    "share_of", "spawns_apart", "split_set", "training_spawn", "training_spawns",
]  # fmt: skip
