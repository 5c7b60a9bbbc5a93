"""People as a tracker reports them: at a rate of its own, with noise, and with frames that are lost."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S, RandomiseConfig
from hrl_comfort.safety.allowances import MOST_LOST
from hrl_comfort.scene.human import LIMBS
from hrl_comfort.sim.variation.randomisation import Values

Array = NDArray[np.float64]


class Tracker:
    """The newest frame of the `people` of N cells, which holds until the next one."""

    def __init__(self, config: RandomiseConfig, rows: int, people: int = 1) -> None:
        self.active = config.tracker
        self._place, self._limbs = np.zeros((rows, people, 2)), np.zeros((rows, people * len(LIMBS), 7))
        """m: the axes (N, P, 2) and the limbs (N, L, 7) of the people in that frame."""
        self._missed = np.zeros(rows, dtype=np.int64)
        self._rate_hz, self._phase = np.ones(rows), np.zeros(rows)
        self._noise_m, self._dropout = np.zeros(rows), np.zeros(rows)
        self._decision: list[tuple[Array, Array, NDArray[np.int64]]] = []

    def begin(self, rows: NDArray[np.int64], values: Values, frames: Array, place: Array, limbs: Array) -> Array:
        """Begin an episode in `rows` (r,) with a frame of people at `place` (r, P, 2) m, `limbs` (r, L, 7).

        Return where they are seen (r, P, 2) m.
        """
        if not self.active:
            return place
        self._rate_hz[rows], self._phase[rows] = values.of("person_rate_hz"), values.phase
        self._noise_m[rows], self._dropout[rows] = values.of("person_noise_m"), values.of("person_dropout")
        self._missed[rows] = 0
        self._place[rows], self._limbs[rows] = _shifted(place, limbs, self._noise_m[rows, None] * frames[:, 0, 1:])
        return self._place[rows]

    @property
    def shown(self) -> Array | None:
        """(N, L, 7) limbs in the newest frame; None without a tracker."""
        return self._limbs if self.active else None

    def begin_decision(self) -> None:
        """Begin a decision, of which some control steps may turn out void."""
        self._decision = []

    def see(self, steps: NDArray[np.int64], frames: Array, place: Array, limbs: Array) -> None:
        """Take the frames (N, FRAMES, 3) due at control step `steps` (N,), of `place` (N, P, 2), `limbs` (N, L, 7).

        Two at most are lost in a row.
        """
        passed = steps * CONTROL_STEP_S * self._rate_hz + self._phase
        before = (steps - 1) * CONTROL_STEP_S * self._rate_hz + self._phase
        due = np.floor(passed) > np.floor(before)
        frame = frames[np.arange(len(frames)), np.floor(passed).astype(np.int64) % frames.shape[1]]
        lost = due & (frame[:, 0] < self._dropout) & (self._missed < MOST_LOST)
        taken = (due & ~lost)[:, None]
        seen, parts = _shifted(place, limbs, self._noise_m[:, None] * frame[:, 1:])
        self._place = np.where(taken[..., None], seen, self._place)
        self._limbs = np.where(taken[..., None], parts, self._limbs)
        self._missed = np.where(due, np.where(lost, self._missed + 1, 0), self._missed)
        self._decision.append((self._place, self._limbs, self._missed))

    def seen(self) -> Array | None:
        """Return where people are seen (N, K, P, 2) m over a decision; None without a tracker."""
        if not self.active:
            return None
        return np.stack([place for place, *_ in self._decision], axis=1)

    def end_decision(self, last: NDArray[np.int64]) -> None:
        """Go back to the last valid control step (N,) of the decision in each row, counted from 0."""
        if self.active:
            rows = np.arange(len(last))
            self._place, self._limbs, self._missed = (
                np.stack(each)[last, rows] for each in zip(*self._decision, strict=True)
            )

    _ARRAYS = ("_place", "_limbs", "_missed", "_rate_hz", "_phase", "_noise_m", "_dropout")

    def state_dict(self) -> dict[str, Any]:
        """Return what an exact continuation needs."""
        return {name: torch.from_numpy(getattr(self, name).copy()) for name in self._ARRAYS if self.active}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        for name, value in saved.items():
            setattr(self, name, value.numpy().copy())


def _shifted(place: Array, limbs: Array, offset: Array) -> tuple[Array, Array]:
    """Return `place` (n, P, 2) m and `limbs` (n, L, 7), all of a frame, moved by its `offset` (n, 2) m."""
    moved = limbs.copy()
    moved[..., :2] += offset[:, None]
    return place + offset[:, None], moved
