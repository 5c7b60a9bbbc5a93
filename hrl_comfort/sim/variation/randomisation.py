"""Domain randomisation: how the cells differ from the model, drawn once an episode.

Set-points reach the servos late, joints are observed with noise, links have another mass and joints have friction. The
person's tracker is in `tracker`. Without a difference nothing is computed: episodes are those of the model.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S, RandomiseConfig
from hrl_comfort.safety.allowances import LARGEST_NOISE
from hrl_comfort.safety.geometry import ArmGeometry
from hrl_comfort.tasks import State

Array = NDArray[np.float64]
READINGS, FRAMES = 256, 256
"""Noise of joints repeats after this many control steps, that of the tracker after this many frames."""
SINGLE = (
    "servo_lag_s", "latency_s", "joint_noise_deg", "joint_velocity_noise_deg_s", "person_noise_m", "person_rate_hz",
    "person_dropout",
)  # fmt: skip
"""Keys of which an episode draws one number; of `link_mass` and `joint_friction` it draws one for each joint."""
OF_OBJECTS = ("object_mass", "object_friction", "object_size")
"""Keys of which an episode draws a factor for each kind of object."""


def draws(config: RandomiseConfig, joints: int, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return an episode's draws: numbers (W,), noise of readings (READINGS, 2 joints), frames (FRAMES, 3).

    All in [0, 1) but the noise of readings and the last two of a frame, which are standard normal up to LARGEST_NOISE.
    Without noise of sensors there are no readings, without a tracker no frames.
    """
    readings, frames = READINGS if config.sensors else 0, FRAMES if config.tracker else 0
    numbers = rng.random(len(SINGLE) + 1 + 2 * joints)
    if not readings and not frames:
        return numbers, np.empty((0, 2 * joints)), np.empty((0, 3))
    noise = np.clip(rng.standard_normal((readings, 2 * joints)), -LARGEST_NOISE, LARGEST_NOISE)
    lost, offset = rng.random((frames, 1)), rng.standard_normal((frames, 2))
    length = np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), 1e-9)
    return numbers, noise, np.concatenate([lost, offset * np.minimum(1.0, LARGEST_NOISE / length)], axis=1)


def object_factors(config: RandomiseConfig, kinds: int, rng: np.random.Generator) -> Array:
    """Return an episode's factors (3, kinds) of mass, sliding friction and size of objects of each kind."""
    low, high = np.array([getattr(config, key) for key in OF_OBJECTS], dtype=np.float64)[..., None].swapaxes(0, 1)
    return np.asarray(low + (high - low) * rng.random((len(OF_OBJECTS), kinds)))


class Values:
    """Values of the keys of `randomise` for drawn numbers (n, W).

    Attributes:
      config: the keys.
      objects: (n, 3, kinds), see `object_factors`; without them objects are those of the model.
    """

    def __init__(self, config: RandomiseConfig, world: Array, objects: Array | None = None) -> None:
        self.config, self._world = config, world
        self.objects = np.ones((len(world), len(OF_OBJECTS), 1)) if objects is None else objects
        self._joints = (world.shape[1] - len(SINGLE) - 1) // 2

    def of(self, key: str) -> Array:
        """Return the values (n,) of `key`."""
        return self._between(key, self._world[:, SINGLE.index(key)])

    @property
    def phase(self) -> Array:
        """(n,) in [0, 1), share of a period of the tracker that has passed when the episode begins."""
        return self._world[:, len(SINGLE)]

    @property
    def mass(self) -> Array:
        """(n, J) factors of the links' mass and inertia."""
        return self._between("link_mass", self._world[:, len(SINGLE) + 1 :][:, : self._joints])

    @property
    def friction(self) -> Array:
        """(n, J) friction of the joints over their largest torque."""
        return self._between("joint_friction", self._world[:, len(SINGLE) + 1 :][:, self._joints :])

    def _between(self, key: str, share: Array) -> Array:
        low, high = getattr(self.config, key)
        return np.asarray(low + (high - low) * share)


class Servos:
    """Set-points of N arms on their way to the servos: late by the latency, and low-pass filtered by the lag."""

    def __init__(self, config: RandomiseConfig, rows: int, joints: int, substeps: int) -> None:
        self.active, self._substeps = config.servos, substeps
        self._step_s = CONTROL_STEP_S / substeps
        length = int(np.ceil(config.latency_s[1] / self._step_s)) + 1
        self._sent = np.zeros((rows, length, joints))
        """Set-points of the last physics steps, the newest last."""
        self._reached = np.zeros((rows, joints))
        self._lag_s, self._latency_s = np.zeros(rows), np.zeros(rows)
        self._decision: list[tuple[Array, Array]] = []
        """Set-points sent and reached after each control step of a decision."""

    def begin(self, rows: NDArray[np.int64], values: Values, targets: Array) -> None:
        """Begin an episode in `rows` (r,), whose set-points have stood at `targets` (r, J) rad."""
        if not self.active:
            return
        self._sent[rows], self._reached[rows] = targets[:, None], targets
        self._lag_s[rows], self._latency_s[rows] = values.of("servo_lag_s"), values.of("latency_s")

    def begin_decision(self) -> None:
        """Begin a decision, of which some control steps may turn out void."""
        self._decision = []

    def follow(self, targets: Array) -> Array:
        """Return what reaches the servos (N, T, J) rad of the set-points `targets` (N, T, J) of T physics steps."""
        if not self.active:
            return targets
        sent = np.concatenate([self._sent, targets], axis=1)
        rows, last = np.arange(len(sent))[:, None], sent.shape[1] - 1
        at = self._sent.shape[1] + np.arange(targets.shape[1]) - (self._latency_s / self._step_s)[:, None]
        before = np.floor(at).astype(np.int64)
        share = (at - before)[..., None]
        late = (1 - share) * sent[rows, before] + share * sent[rows, np.minimum(before + 1, last)]
        reached, gain = self._reached, (self._step_s / (self._lag_s + self._step_s))[:, None]
        out = np.empty_like(late)
        for step in range(late.shape[1]):
            out[:, step] = reached = reached + gain * (late[:, step] - reached)
        for passed in range(self._substeps, late.shape[1] + 1, self._substeps):
            self._decision.append((sent[:, passed : passed + self._sent.shape[1]], out[:, passed - 1]))
        self._sent, self._reached = self._decision[-1]
        return out

    def end_decision(self, last: NDArray[np.int64]) -> None:
        """End a decision whose last valid control step is `last` (N,), counted from 0."""
        if self.active:
            rows = np.arange(len(last))
            self._sent, self._reached = (np.stack(each)[last, rows] for each in zip(*self._decision, strict=True))

    _ARRAYS = ("_sent", "_reached", "_lag_s", "_latency_s")

    def state_dict(self) -> dict[str, Any]:
        """Return what an exact continuation needs."""
        return {name: torch.from_numpy(getattr(self, name).copy()) for name in self._ARRAYS if self.active}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        for name, value in saved.items():
            setattr(self, name, value.numpy().copy())


def observed(config: RandomiseConfig, values: Values, readings: Array, state: State, arm: ArmGeometry) -> State:
    """Return `state` with joints, and the tool at them, as the sensors report them; `readings` (N, READINGS, 2 J)."""
    if not config.sensors:
        return state
    noise = readings[np.arange(len(readings)), state.steps.numpy() % READINGS]
    joints = state.joint_pos.shape[1]
    deviation = np.radians(values.of("joint_noise_deg")), np.radians(values.of("joint_velocity_noise_deg_s"))
    angles = state.joint_pos.numpy() + deviation[0][:, None] * noise[:, :joints]
    velocity = state.joint_vel.numpy() + deviation[1][:, None] * noise[:, joints:]
    changes = {"joint_pos": angles, "joint_vel": velocity, "tcp_pos": np.ascontiguousarray(arm.tool(angles))}
    return state.with_(**{name: torch.from_numpy(value) for name, value in changes.items()})
