"""The person of the studio: taken over by drag or keys, and let go to a motion again."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from hrl_comfort import humans
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import HumanConfig, SafetyConfig
from hrl_comfort.humans.motions.live import HELD
from hrl_comfort.humans.walk import Array
from hrl_comfort.studio.session import Session

KEYS = {"w": (1.0, 0.0), "s": (-1.0, 0.0), "a": (0.0, 1.0), "d": (0.0, -1.0)}
"""Steps forward and to the left, by key."""
TURNS = {"q": 1.0, "e": -1.0}
"""Turns to the left, by key."""
TURN_RAD_S = 1.5
HELD_S = 0.6
"""Time after which a key is let go of unless it is reported again; a tab that closes reports nothing."""
FARTHEST_M = 2.5
"""Largest distance from the robot's base to which a person can be driven."""
ARRIVED_M = 0.01
FASTEST_M_S = 3.0
"""Largest limit of the walk by hand, without a shield."""


class Person:
    """Hand on the person of some cells; one pose drives all of them.

    Args:
      sessions: the cells.
      live: configuration of the motion `live`; its `speed_m_s` limits the walk.
      human: configuration of the motion to which the person is let go; whether policies observe the person is as it
        says, by hand too.
    """

    def __init__(
        self,
        sessions: Sequence[Session],
        live: HumanConfig,
        human: HumanConfig,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._sessions, self._live, self.human, self._clock = sessions, live, human, clock
        self._keys: frozenset[str] = frozenset()
        self._pressed_s = -np.inf
        self.taken = False
        self._leaving = False
        self.speed_m_s = live.speed_m_s
        if human.motion == "live" and human.file is None:
            self.take()

    @property
    def speed_m_s(self) -> float:
        """Limit of the walk by hand."""
        return self._live.speed_m_s

    @speed_m_s.setter
    def speed_m_s(self, limit: float) -> None:
        self._live = replace(self._live, speed_m_s=min(limit, self.fastest_m_s))
        self._hold()

    @property
    def fastest_m_s(self) -> float:
        """Largest limit of the walk by hand: what the shields assume of people, FASTEST_M_S without one."""
        return min(fastest_m_s(session.config.safety) for session in self._sessions)

    def rejoin(self) -> None:
        """Hold the person of sessions that are new, or let them move, as in those before."""
        if not (self.taken or self._leaving):
            self._set_motion(self.human)
        self.speed_m_s = self._live.speed_m_s

    def _hold(self) -> None:
        """Give the motion by hand to a person who is held or walks to where they are let go."""
        if self.taken or self._leaving:
            self._set_motion(observed_as(self._live, self.human))

    @property
    def motion(self) -> str:
        """Name of the motion in force."""
        return "by hand" if self.taken else self.human.motion

    def take(self) -> None:
        """Hold the person where they are."""
        if not self.taken:
            self.taken, self._leaving = True, False
            self._stop()
            self._hold()

    def stay(self) -> None:
        """Stay where an episode begins, which is beside the arm; for a person by hand."""
        if self.taken:
            self._stop()

    def let_go(self, human: HumanConfig | None = None) -> None:
        """Let the person go on as `human` says (default: as before).

        They first leave its keep-out discs and let their arms hang.
        """
        self.human = human or self.human
        self.taken, self._keys, HELD.hands = False, frozenset(), None
        if humans.free(self.human):
            self._leaving = False
            self._set_motion(self.human)
        else:
            self._leaving = True
            self._hold()
            self.update(0.0)

    def follow(self, human: HumanConfig) -> None:
        """Go on as `human` says, or once they are let go of."""
        if self.taken:
            self.human = human
            self._hold()
        else:
            self.let_go(human)

    def drag(self, x: float, y: float) -> None:
        """Walk to (x, y) m, or to the nearest point within FARTHEST_M of the base."""
        self.take()
        self._keys = frozenset()
        shrink = min(1.0, FARTHEST_M / max(float(np.hypot(x, y)), 1e-9))
        HELD.pose = (shrink * x, shrink * y, None)

    @property
    def hands(self) -> Array | None:
        """Places of held hands, (2, 3) m in the person's frame; None where they hang or do as the motion says."""
        return HELD.hands

    def reach(self, hands: Array | None) -> None:
        """Hold the hands at (2, 3) m, left first, in the person's frame; None lets them hang."""
        if hands is not None:
            self.take()
        HELD.hands = hands

    def press(self, keys: frozenset[str]) -> None:
        """Walk and turn as these of KEYS and TURNS say, until others are pressed or HELD_S have passed."""
        keys = keys & (KEYS.keys() | TURNS.keys())
        if keys or self._keys:
            self.take()
            self._keys, self._pressed_s = keys, self._clock()
            if not keys:
                self._stop()

    def update(self, duration_s: float) -> None:
        """Set the pose at which the person is to be after the next decision, which lasts `duration_s`."""
        if self._leaving:
            self._leave()
        if not self._keys:
            return
        if self._clock() - self._pressed_s > HELD_S:
            self._keys = frozenset()
            self._stop()
            return
        walk = self._sessions[0].walk
        yaw = float(walk.yaw[0]) + duration_s * TURN_RAD_S * sum(TURNS.get(key, 0.0) for key in self._keys)
        ahead, left = np.sum([KEYS.get(key, (0.0, 0.0)) for key in self._keys], axis=0)
        stride = self.speed_m_s * duration_s / max(float(np.hypot(ahead, left)), 1.0)
        place = walk.position[0] + stride * (
            ahead * np.array([np.cos(yaw), np.sin(yaw)]) + left * np.array([-np.sin(yaw), np.cos(yaw)])
        )
        place *= min(1.0, FARTHEST_M / max(float(np.hypot(*place)), 1e-9))
        HELD.pose = (float(place[0]), float(place[1]), yaw)

    def _leave(self) -> None:
        """Walk out of the keep-out discs and let the arms hang; there the motion begins."""
        session = self._sessions[0]
        episodes = session.engine.episodes
        position = session.walk.position
        free = humans.outside(position, episodes.sampler.keep_out(episodes.draw.points, episodes.draw.goals))
        if float(np.linalg.norm(free - position)) <= ARRIVED_M and np.isnan(session.walk.limbs).all():
            self._leaving = False
            self._set_motion(self.human)
        else:
            HELD.pose = (float(free[0, 0]), float(free[0, 1]), None)

    def _stop(self) -> None:
        walk = self._sessions[0].walk
        HELD.pose = (float(walk.position[0, 0]), float(walk.position[0, 1]), float(walk.yaw[0]))

    def _set_motion(self, human: HumanConfig) -> None:
        for session in self._sessions:
            session.keep_person = self.taken or self._leaving
            session.set_motion(human)


def fastest_m_s(safety: SafetyConfig) -> float:
    """Return the largest speed at which a person by hand may walk, m/s."""
    return FASTEST_M_S if safety.kind == "none" else min(FASTEST_M_S, safety.human_speed_m_s)


def observed_as(human: HumanConfig, run: HumanConfig) -> HumanConfig:
    """Return the motion `human`, of whom policies observe as much as of `run`."""
    return replace(human, clipping=run.clipping)


def motion_config(name: str) -> HumanConfig:
    """Return the configuration of the motion `name` as in `conf/human/`."""
    human = getattr(compose("studio", [f"human={name}"]), "human", None)
    assert isinstance(human, HumanConfig)
    return human
