"""Arms that follow set-points, one every PERIOD_S, and their hands."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import FAR_AWAY_M
from hrl_comfort.scene.workcell import Scene

Array = NDArray[np.float64]
PERIOD_S = 0.002
"""Time between set-points: 500 Hz, as the controllers of UR's e-series have it."""


STILL_PER_S = 0.05
"""Speed of the drive below which fingers stand, in its ways from open to closed."""


class Fingers(IntEnum):
    """State of the fingers, by the numbers of Robotiq's `OBJ`."""

    MOVE = 0
    STOPPED_OPENING = 1
    """By an object outside them."""
    GRIP = 2
    """They were stopped by an object while closing."""
    THERE = 3
    """They are at the set-point: there is no object, or it has been lost."""


@dataclass(frozen=True)
class HandReading:
    """State of a hand."""

    closed: float
    """0 is open, 1 closed."""
    fingers: Fingers
    trouble: str = ""
    """Reason why the fingers follow no set-points; empty where they do."""


@dataclass(frozen=True)
class Reading:
    """State of an arm of J joints."""

    angles: Array
    """(J,) rad."""
    velocity: Array
    """(J,) rad/s."""
    trouble: str = ""
    """Reason why the arm follows no set-points; empty where it does."""
    hand: HandReading | None = None
    """None of an arm without a hand."""


class Hand(Protocol):
    """A hand that follows set-points of its fingers."""

    def read(self) -> HandReading:
        """Return the newest state; raise ConnectionError where the connection is lost."""

    def send(self, closed: float) -> None:
        """Give the set-point, 0 open to 1 closed; raise ConnectionError where the connection is lost."""

    def close(self) -> None:
        """End the connection; the fingers stay where they are, and keep what they hold."""


class Arm(Protocol):
    """An arm that follows set-points."""

    def read(self) -> Reading:
        """Return the newest state; raise ConnectionError where the connection is lost."""

    def send(self, angles: Array) -> None:
        """Give the set-point (J,) rad, with a hand (J + 1,); raise ConnectionError where the connection is lost.

        The last number of an arm with a hand is that of the fingers, see `Hand`.
        """

    def lay(self, objects: Array) -> None:
        """Lay the objects at their poses (B, 7), m and quaternion; beside a real arm people do."""

    def close(self) -> None:
        """End the connection; the arm stays where it is."""


class SimulatedArm:
    """The arm of a scene, one physics step a set-point.

    Args:
      model: of the cell.
      start: (J,) rad, where it stands at first.
    """

    def __init__(self, model: mujoco.MjModel, start: Array) -> None:
        self._model = model
        self._model.opt.timestep = PERIOD_S
        self._data = mujoco.MjData(model)
        self._data.qpos[:] = self._data.ctrl[:] = start
        mujoco.mj_forward(model, self._data)

    def read(self) -> Reading:
        """See `Arm`."""
        return Reading(self._data.qpos.copy(), self._data.qvel.copy())

    def send(self, angles: Array) -> None:
        """See `Arm`."""
        self._data.ctrl[:] = angles
        mujoco.mj_step(self._model, self._data)

    def lay(self, objects: Array) -> None:
        """See `Arm`; without a hand there are none."""

    def close(self) -> None:
        """See `Arm`."""


class SimulatedHand:
    """The arm and the fingers of a scene with a gripper, one physics step a set-point, and the objects beside them.

    Args:
      scene: with a gripper; the arm stands at home at first, the hand open, and the objects are far away.
    """

    def __init__(self, scene: Scene) -> None:
        self._model, self._at, joints = scene.model, scene.sensors, len(scene.joints)
        self._model.opt.timestep = PERIOD_S
        self._open, self._closed = self._model.actuator_ctrlrange[joints]
        self._angles, self._velocity = np.split(scene.moving - 1, 2)
        self._velocity = self._velocity - self._model.nq
        self._objects = [self._model.joint(name) for name in scene.loose]
        self._data = mujoco.MjData(self._model)
        self._data.qpos[self._angles] = self._data.ctrl[:joints] = scene.home
        self._data.ctrl[joints] = self._open
        far = np.zeros((len(scene.loose), 7))
        far[:, 0], far[:, 1], far[:, 3] = FAR_AWAY_M, np.arange(len(far)), 1.0
        self.lay(far)

    @property
    def objects(self) -> Array:
        """(B, 7) poses of the objects, m and quaternion."""
        return np.array([self._data.qpos[each.qposadr[0] :][:7] for each in self._objects])

    def lay(self, objects: Array) -> None:
        """See `Arm`."""
        for joint, pose in zip(self._objects, objects, strict=True):
            self._data.qpos[joint.qposadr[0] :][:7] = pose
            self._data.qvel[joint.dofadr[0] :][:6] = 0.0
        mujoco.mj_forward(self._model, self._data)

    def read(self) -> Reading:
        """See `Arm`."""
        data, way = self._data, self._closed - self._open
        sensed = data.sensordata
        closed, speed = sensed[self._at["hand_pos"]][0] - self._open, sensed[self._at["hand_vel"]][0]
        left = (data.ctrl[-1] - self._open - closed) / way
        gripped = (sensed[self._at["pads"]].reshape(-1, 2) > 0).all(axis=1).any()
        fingers = Fingers.MOVE
        if abs(speed / way) < STILL_PER_S:
            fingers = Fingers.GRIP if gripped and left > 0 else Fingers.THERE
        hand = HandReading(float(closed / way), fingers)
        return Reading(data.qpos[self._angles].copy(), data.qvel[self._velocity].copy(), hand=hand)

    def send(self, angles: Array) -> None:
        """See `Arm`."""
        self._data.ctrl[:-1] = angles[:-1]
        self._data.ctrl[-1] = self._open + angles[-1] * (self._closed - self._open)
        mujoco.mj_step(self._model, self._data)

    def close(self) -> None:
        """See `Arm`."""


class Equipped:
    """An arm with a hand that has a connection of its own."""

    def __init__(self, arm: Arm, hand: Hand) -> None:
        self._arm, self._hand = arm, hand

    def read(self) -> Reading:
        """See `Arm`."""
        reading, hand = self._arm.read(), self._hand.read()
        return replace(reading, trouble=reading.trouble or hand.trouble, hand=hand)

    def send(self, angles: Array) -> None:
        """See `Arm`."""
        self._arm.send(angles[:-1])
        self._hand.send(float(angles[-1]))

    def lay(self, objects: Array) -> None:
        """See `Arm`."""
        self._arm.lay(objects)

    def close(self) -> None:
        """See `Arm`."""
        self._hand.close()
        self._arm.close()
