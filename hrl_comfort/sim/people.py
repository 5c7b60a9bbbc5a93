"""The people of N cells, one control step at a time.

People stop where they touch the arm, draw back the hand that touches it, and step back: one who walks on pushes without
limit, and the physics goes unstable; one who stays stands in the arm's way for ever.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from hrl_comfort import humans
from hrl_comfort.compiled import contiguous
from hrl_comfort.config import HumanConfig
from hrl_comfort.instants import chosen, ended_early
from hrl_comfort.safety import kernels, people_kernels
from hrl_comfort.safety.geometry import ArmGeometry, PersonGeometry
from hrl_comfort.safety.people_kernels import OVERLAP_M
from hrl_comfort.safety.separation import Encounter, Separation
from hrl_comfort.scene.human import BODY
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.controls import limbs_of
from hrl_comfort.sim.variation.disturbance import Disturbance

Array = NDArray[np.float64]
Leaves = Callable[[humans.Walk], NDArray[np.bool_]]
"""`Motions.leaves`."""
MOVING = ("position", "yaw", "walked_m", "speed_m_s", "step", "velocity", "limbs", "memory", "retreat")
"""Fields of `people_kernels.Moving`."""


@dataclass(frozen=True)
class Crowd:
    """The P people of N cells at one instant."""

    walks: tuple[humans.Walk, ...]
    """The walk (N) of each person."""
    limbs: Array
    """(N, L, 7) poses of the limbs of all of them, m and quaternion, by `Scene.limbs`."""
    ends: Array
    """(3, Q, 2, N) m, ends of the axes of their capsules."""

    @property
    def places(self) -> Array:
        """(N, P, 2) m, axes of the people; of one without a copy."""
        each = [walk.position for walk in self.walks]
        return each[0][:, None] if len(each) == 1 else np.stack(each, axis=1)

    def put(self, rows: NDArray[np.int64], other: Crowd) -> Crowd:
        """Return a copy whose `rows` (r,) are those of `other` (r)."""
        limbs, ends = self.limbs.copy(), self.ends.copy()
        limbs[rows], ends[..., rows] = other.limbs, other.ends
        walks = zip(self.walks, other.walks, strict=True)
        return Crowd(tuple(mine.put(rows, its) for mine, its in walks), limbs, ends)

    @classmethod
    def chosen(cls, crowds: Sequence[Crowd], index: NDArray[np.int64]) -> Crowd:
        """Return the people of N cells of whom those of each are as in the one of `crowds` that `index` (N,) names."""
        if (index == index[0]).all():
            return crowds[index[0]]
        walks = [humans.Walk.chosen(walks, index) for walks in zip(*(each.walks for each in crowds), strict=True)]
        early = ended_early(index, len(crowds))
        limbs, ends = (
            chosen([each.limbs for each in crowds], early),
            chosen([each.ends for each in crowds], early, True),
        )
        return cls(tuple(walks), limbs, ends)


class People:
    """The people of N cells.

    Args:
      scene: with their bodies.
      separation: of arm and people.
      config: of all of them.
      disturbance: which may hold the first where they are.
      rows: number N of cells.
    """

    def __init__(
        self, scene: Scene, separation: Separation, config: HumanConfig, disturbance: Disturbance, rows: int
    ) -> None:
        self._scene, self._separation, self._disturbance = scene, separation, disturbance
        self.everyone = list(config.everyone)
        """Configuration by which each person moves now."""
        self._motions = [humans.Motions(each) for each in self.everyone]
        self.now = self.crowd([humans.begin(each, np.zeros((rows, 2))) for each in self.everyone])
        """People as the decision begins."""
        self.course: list[Crowd] = []
        """People as the decision begins and after each of its control steps."""
        self._around: list[humans.Surroundings] = []
        """Surroundings that each person sees while a decision lasts: the robot as at its beginning."""
        self.way = 0.0
        """m, farthest that the end of any capsule went in the latest control step beside the arms."""

    def crowd(self, walks: Sequence[humans.Walk]) -> Crowd:
        """Return people who walk as `walks`, one of each person, say."""
        each = [limbs_of(self._scene, walk) for walk in walks]
        limbs = each[0] if len(each) == 1 else np.concatenate(each, axis=1)
        return Crowd(tuple(walks), limbs, self._separation.person.ends(limbs))

    def begin(self, rows: NDArray[np.int64], spawns: Array, traits: Array) -> Crowd:
        """Begin episodes in `rows` (r,), at `spawns` (r, P, 2) m, with `traits` (r, P, TRAITS); return their people."""
        each = enumerate(self.everyone)
        fresh = self.crowd([humans.begin(human, spawns[:, index], traits[:, index]) for index, human in each])
        self.now = self.now.put(rows, fresh)
        return fresh

    def begin_decision(self, around: humans.Surroundings) -> None:
        """Begin a decision beside what the first sees; the discs of others are as wide as they are configured."""
        discs = [humans.KeepOut(around.keep_out.centres, each.keep_out_m) for each in self.everyone[1:]]
        self._around = [around, *(replace(around, keep_out=own) for own in discs)]
        self.course = [self.now]

    def step(self, noise: Array, times: NDArray[np.int64], now: Encounter | None) -> Crowd:
        """Return the people after another control step, of index `times` (N,) in their episodes.

        `noise` (N, P, NOISE) in [0, 1) moves them. Those who would walk into the arms of `now`, which are beside the
        people before it, stop at them; without it nobody stops.
        """
        before = self.course[-1]
        walks = [
            motions.advance(walk, noise[:, index], self._around[index])
            for index, (motions, walk) in enumerate(zip(self._motions, before.walks, strict=True))
        ]
        walks[0] = self._disturbance.walked(before.walks[0], walks[0], times)
        if now is None:
            self.course.append(self.crowd(walks))
        else:
            leaves = [motions.leaves for motions in self._motions]
            crowd, self.way = stop_at_contact(self._scene, self._separation, now, before, walks, leaves)
            self.course.append(crowd)
        return self.course[-1]

    def end_decision(self, last: NDArray[np.int64]) -> None:
        """End a decision whose last valid control step is `last` (N,), counted from 0."""
        self.now = Crowd.chosen(self.course[1:], last)

    def stand(self, walk: humans.Walk) -> Crowd:
        """Let the first be as `walk` (N) says; return the people."""
        self.now = self.crowd([walk, *self.now.walks[1:]])
        return self.now

    def redraw_stays(self, uniform: Array) -> None:
        """Let everybody stay as long as others might who look alike; uniform (N, P) in [0, 1)."""
        each = enumerate(zip(self.everyone, self.now.walks, strict=True))
        self.now = self.crowd(
            [humans.with_other_stays(human, walk, uniform[:, index]) for index, (human, walk) in each]
        )

    def follow_at(self, speed_m_s: float) -> None:
        """Let people of `live` walk to where their source says at up to `speed_m_s`, whatever they are configured."""
        live = [each.motion == "live" for each in self.everyone]
        hurried = zip(self.everyone, live, strict=True)
        self.everyone = [replace(each, speed_m_s=speed_m_s) if follows else each for each, follows in hurried]
        self._motions = [humans.Motions(each) for each in self.everyone]

    def go_on_as(self, human: HumanConfig) -> None:
        """Let the first go on from where they are as `human` says; who was nobody comes in where they would begin.

        Another motion begins with its own memory and arms; a person moved by hand lowers the arms they have.
        """
        first, (walk, *others) = self.everyone[0], self.now.walks
        if first.motion == "none":
            walk = humans.begin(human, walk.spawn)
        elif human.motion != "none":
            walk = replace(walk, spawn=walk.position.copy())
            if (human.motion, human.mixture) != (first.motion, first.mixture):
                begun, by_hand = humans.begin(human, walk.spawn, walk.traits), human.motion == "live" and not human.file
                walk = replace(walk, memory=begun.memory, limbs=walk.limbs if by_hand else begun.limbs)
        self.everyone[0], self.now = human.everyone[0], self.crowd([walk, *others])
        self._motions[0] = humans.Motions(self.everyone[0])

    def state_dict(self) -> list[dict[str, Any]]:
        """Return what an exact continuation needs, of each person."""
        return [{name: torch.from_numpy(value.copy()) for name, value in vars(walk).items()} for walk in self.now.walks]

    def load_state_dict(self, saved: list[dict[str, Any]]) -> None:
        """Continue from `state_dict`."""
        self.now = self.crowd([
            humans.Walk(**{name: value.numpy().copy() for name, value in walk.items()}) for walk in saved
        ])  # fmt: skip


def share_walked(room: Array, gap: Array) -> Array:
    """Return the share (n,) of a step that ends at OVERLAP_M, 1 if it is free.

    It begins at `room` (n,) m from the arm and would end at `gap` (n,) m from it.
    """
    share = np.clip((room + OVERLAP_M) / np.maximum(room - gap, 1e-9), 0.0, 1.0)
    return np.where(gap < room, share, 1.0)


def stop_at_contact(
    scene: Scene,
    separation: Separation,
    now: Encounter,
    before: Crowd,
    walks: Sequence[humans.Walk],
    leaves: Sequence[Leaves],
) -> tuple[Crowd, float]:
    """Return the people of `walks` with those who would walk into the arms held at OVERLAP_M.

    `before` and `walks` are the people before and after a control step, `now` the arms beside those before it. Those
    held who leave an arm that they touch (`leaves`, a function a person) draw the hand back. Each person is looked at
    alone. Return also how far, m, the end of any capsule went at most.
    """
    found, begin = [], 0
    for person, stood, walk, leaving in zip(separation.each, before.walks, walks, leaves, strict=True):
        part = slice(begin, begin + len(person.radius))
        beside = now if len(walks) == 1 else replace(now, person=now.person[:, part])
        found.append(_stopped(scene, separation.arm, person, beside, stood, walk, leaving))
        begin = part.stop
    if len(found) == 1:
        return found[0]
    each, ways = zip(*found, strict=True)
    limbs, ends = (np.concatenate([getattr(one, name) for one in each], axis=1) for name in ("limbs", "ends"))
    return Crowd(tuple(one.walks[0] for one in each), limbs, ends), max(ways)


def _stopped(
    scene: Scene,
    arm: ArmGeometry,
    person: PersonGeometry,
    now: Encounter,
    before: humans.Walk,
    walk: humans.Walk,
    leaves: Leaves,
) -> tuple[Crowd, float]:
    """Return what `stop_at_contact` does of one `person`, whose capsules are those of `now`."""
    walked = contiguous(walk.position, walk.yaw, walk.walked_m, walk.speed_m_s, walk.limbs)
    given = contiguous(now.pose.ends, now.apart, now.person)
    # Somebody else may have been nearer than this person.
    limbs, ends, gap, touching, way = kernels.arrive(
        *walked, scene.floor_z, BODY, *person.compiled, *given, arm.radius, person.radius
    )
    if not touching:
        return Crowd((walk,), limbs, ends), way
    held, arm_and_person = walk.copy(), (given[0], given[2])
    most = people_kernels.hold(
        moving(held), moving(before), np.cos(before.yaw), np.sin(before.yaw), leaves(before), scene.floor_z, BODY,
        person.compiled, *arm_and_person, gap, arm.radius, person.radius, limbs, ends,
    )  # fmt: skip
    return Crowd((held,), limbs, ends), max(way, most)


def moving(walk: humans.Walk) -> people_kernels.Moving:
    """Return the fields of a walk that change in a control step, as kernels take them."""
    position, yaw, walked_m, speed_m_s, step, velocity, limbs, memory, retreat = contiguous(
        *(getattr(walk, name) for name in MOVING)
    )
    return position, yaw, walked_m, speed_m_s, step, velocity, limbs, memory, retreat
