"""An arm and its hand in simulated time, at the other end of a network with delays in each direction."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.deploy.arms import PERIOD_S, Arm, Fingers, Reading, SimulatedHand
from hrl_comfort.scene.workcell import Scene
from tests.deploy.fake_robotiq import FakeRobotiq

Array = NDArray[np.float64]
PULL_N, OUT_M = 1.0, 0.1
"""Growth, in a set-point, of the force that pulls at an object, and its distance from the tool at which it is out of
the hand."""


class Late:
    """An arm behind a network that takes `latency_s` in each direction and loses a share of packages."""

    def __init__(self, arm: Arm, start: Array, latency_s: float, loss: float, seed: int) -> None:
        self._arm, periods = arm, round(latency_s / PERIOD_S)
        self._there, self._back = deque([start] * periods), deque([arm.read()] * periods)
        self._rng, self._loss, self._newest = np.random.default_rng(seed), loss, arm.read()

    def send(self, angles: Array) -> None:
        self._there.append(self._there[-1] if self._rng.random() < self._loss else angles.copy())
        self._arm.send(self._there.popleft())
        self._back.append(self._back[-1] if self._rng.random() < self._loss else self._arm.read())
        self._newest = self._back.popleft()

    def read(self) -> Reading:
        return self._newest

    def lay(self, objects: Array) -> None:
        self._arm.lay(objects)

    def close(self) -> None:
        self._arm.close()


class LateLoopback:
    """In the place of the hand's socket: once it does not block, lines and answers take `periods` of `world` each."""

    def __init__(self, server: FakeRobotiq, world: PulledHand, periods: int) -> None:
        self._server, self._world, self._periods = server, world, periods
        self._asked, self._said = deque[tuple[int, str]](), deque[tuple[int, bytes]]()
        self._late = 0

    def sendall(self, data: bytes) -> None:
        self._asked.append((self._world.ticks + self._late, data.decode().strip()))

    def recv(self, size: int) -> bytes:
        now = self._world.ticks
        while self._asked and self._asked[0][0] <= now:
            self._said.append((now + self._late, self._server.answer(self._asked.popleft()[1])))
        if not self._said or self._said[0][0] > now:
            raise BlockingIOError
        return self._said.popleft()[1]

    def setblocking(self, flag: bool) -> None:
        self._late = 0 if flag else self._periods

    def close(self) -> None:
        pass


class PulledHand(SimulatedHand):
    """See `SimulatedHand`; what the fingers have held for `pull_after` set-points is pulled out by force; 0: nothing.

    `ticks` counts the set-points, `pulled_at` is the first at which it is pulled, `lost_at` the first at which a pad no
    longer touches it.
    """

    def __init__(self, scene: Scene, pull_after: int, seed: int) -> None:
        super().__init__(scene)
        self._scene, self._left = scene, pull_after
        self.ticks = self.pulled_at = self.lost_at = 0
        way = np.random.default_rng(seed).normal(size=3)
        self._pull, self._force = way / np.linalg.norm(way), 0.0
        self._pulled: int | None = None

    def send(self, angles: Array) -> None:
        super().send(angles)
        self.ticks += 1
        touched = (self._data.sensordata[self._scene.sensors["pads"]].reshape(-1, 2) > 0).all(axis=1)
        if self._pulled is None:
            hand = self.read().hand
            if self._left and touched.any() and hand is not None and hand.fingers == Fingers.GRIP:
                self._left -= 1
                if not self._left:
                    self._pulled, self.pulled_at = int(touched.argmax()), self.ticks
            return
        if not self.lost_at and not touched[self._pulled]:
            self.lost_at = self.ticks
        away = self.objects[self._pulled, :3] - self._data.site("robot/tcp").xpos
        body = self._model.body(self._scene.loose[self._pulled]).id
        self._force += PULL_N
        across = self._data.site("robot/tcp").xmat.reshape(3, 3)[:, 0]  # pads would stop it
        out = self._pull - (self._pull @ across) * across
        out *= self._force / np.linalg.norm(out)
        self._data.xfrc_applied[body, :3] = out if np.linalg.norm(away) < OUT_M else 0.0
