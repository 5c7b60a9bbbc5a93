"""Fields of `State` that no sensor reads: those planned before the physics runs, and those of an episode's start."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.config import PrecisionConfig
from hrl_comfort.humans import Walk
from hrl_comfort.safety.drive import SetPoints
from hrl_comfort.sim.episode_sampler import Draw
from hrl_comfort.tasks import State

Array = NDArray[np.float64]


SET_POINTS = {"angles": "joint_target", "velocity": "target_vel"}
"""Field of `SetPoints` -> field of `State`, where they differ."""


def set_points(state: State) -> SetPoints:
    """Return the set-points (N) of a state."""
    named = (SET_POINTS.get(field.name, field.name) for field in fields(SetPoints))
    return SetPoints(*(getattr(state, name).numpy() for name in named))


def human_fields(walk: Walk, places: Array, seen: Array) -> dict[str, NDArray[Any]]:
    """Return the fields (n, ...) of people; `places` and `seen` as in `planned_fields`."""
    shown = (seen == places).all(axis=1)
    return {"human_pos": walk.position, "human_yaw": walk.yaw, "human_seen": seen, "human_shown": shown}


def planned_fields(
    walk: Walk, places: Array, seen: Array, limbs: Array, points: SetPoints, steps: NDArray[np.int64]
) -> dict[str, NDArray[Any]]:
    """Return the fields (n, ...) that are known before the physics runs, and the `limbs` (n, L, 7).

    `places` (n, 2) m are where the human was measured, `seen` (n, 2) m where policies see them, `steps` (n,) the
    control steps of the episode afterwards.
    """
    planned = {SET_POINTS.get(name, name): value for name, value in vars(points).items()}
    return {**planned, **human_fields(walk, places, seen), "steps": steps, "limbs": limbs}


def first_fields(
    draw: Draw, rows: NDArray[np.int64], precision: PrecisionConfig, precision_m: float, level: Array,
    tcp_home: Array, joint_home: Array,
) -> dict[str, Tensor]:  # fmt: skip
    """Return the fields (r, ...) of `rows` (r,) that stay, or begin, as drawn.

    The first object is the target, none is placed. All tolerances scale with `precision_m`.
    """
    n, scale = len(rows), precision_m / precision.grasp_tolerance_m
    kinds = draw.kinds[rows]
    constant = {
        "tcp_home": tcp_home,
        "joint_home": joint_home,
        "target": np.int64(0),
        "stage": np.int64(0),
        "grasp_tolerance": precision_m,
        "place_tolerance": scale * precision.place_tolerance_m,
        "home_tolerance": scale * np.radians(precision.home_tolerance_deg),
    }
    known = {
        **{name: np.repeat(np.asarray(value)[None], n, axis=0) for name, value in constant.items()},
        "places": draw.places[rows, :, :3],
        "kind_places": draw.kind_places[rows],
        "points": draw.points[rows],
        "objects": draw.objects(rows),
        "kinds": kinds,
        "placed": np.zeros(kinds.shape, dtype=bool),
        "level": level,
    }
    return {name: torch.from_numpy(value) for name, value in known.items()}
