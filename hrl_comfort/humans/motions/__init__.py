"""Human motions, and their bounds; those of `kernels` are compiled, the others have a file each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from hrl_comfort.compiled import contiguous
from hrl_comfort.config import CONTROL_STEP_S, HumanConfig
from hrl_comfort.config.checks import function
from hrl_comfort.humans.motions.adversary import adversary
from hrl_comfort.humans.motions.live import live
from hrl_comfort.humans.motions.moves import NUMBERS
from hrl_comfort.humans.motions.none import none
from hrl_comfort.humans.motions.recorded import recorded
from hrl_comfort.humans.motions.step import COMPILED, propose
from hrl_comfort.humans.motions.still import still
from hrl_comfort.humans.recordings import bounds as recorded_bounds
from hrl_comfort.humans.recordings import read_recordings
from hrl_comfort.humans.walk import Array, Motion, Stride, Surroundings, Walk


class Compiled:
    """The motions of COMPILED of some people, each of whom draws one of `members`; those who draw another stay."""

    def __init__(self, members: Sequence[HumanConfig]) -> None:
        kinds = np.array([KINDS.get(each.motion, -1) for each in members])
        numbers = [[getattr(each, name) for name in NUMBERS] for each in members]
        self.motions = kinds, np.array(numbers, dtype=np.float64)
        """Their kinds (M,) and numbers (M, NUMBERS), as kernels take them."""
        self._answers = any(each.motion == "reactive" for each in members)

    def beside(self, walk: Walk, noise: Array, around: Surroundings) -> tuple[Any, ...]:
        """Return noise and what people see as kernels take it; the arm alone if somebody answers it, or retreats."""
        discs, nothing = around.keep_out, np.empty((len(noise), 0, 3))
        points, moving = around.arm() if self._answers or walk.retreat.any() else (nothing, nothing)
        seen = contiguous(noise, around.tcp, discs.centres, around.stations, points, moving)
        return *seen[:3], float(discs.radius_m), *seen[3:]


def compiled(config: HumanConfig, walk: Walk, noise: Array, around: Surroundings) -> Stride:
    """Return the stride of people who all move as `config` says, by one of COMPILED."""
    motions = Compiled([config])
    proposed = walk.proposed()
    moved = contiguous(walk.position, walk.yaw, walk.spawn, walk.step, walk.velocity, walk.traits)
    propose(*motions.motions, *proposed, *moved, *motions.beside(walk, noise, around))
    return Stride(*proposed)


KINDS = {name: kind for kind, name in enumerate(COMPILED)}
MOTIONS: dict[str, Motion] = {
    **{each.__name__: each for each in (none, still)},
    **dict.fromkeys(COMPILED, compiled),
    **{each.__name__: each for each in (adversary, recorded, live)},
}
CARRIERS = ("patrol", "worker", "reactive", "fetcher")
"""Motions of people who hold their hands before the body."""
STEERED = (*CARRIERS, "adversary")
"""Motions that keep to `acceleration_m_s2` where it is set, and mind keep-out discs themselves."""
UNBOUNDED = ("none", "recorded", "live")
"""Further motions to which `bound_m` and `keep_out_m` do not apply."""


def motion(name: str) -> Motion:
    """Return the motion `name`: one of MOTIONS, an entry point, or `package.module:name`.

    Raises:
      ConfigError: there is none.
    """
    return function("human.motion", name, MOTIONS)


def free(config: HumanConfig) -> bool:
    """Return whether `bound_m` and the cut at keep-out discs do not apply to the human of `config`."""
    return config.motion in UNBOUNDED or (config.motion in STEERED and config.acceleration_m_s2 is not None)


def bounds(config: HumanConfig) -> tuple[float, float]:
    """Return the largest speed (m/s) and acceleration (m/s²) of the person's axis under `config`.

    The motions of the paper jump: their acceleration has no bound. A step that is cut at a disc is at most twice as
    long as the motion's own. Motions of other packages state no bounds.
    """
    if config.mixture:
        speeds, accelerations = zip(*map(bounds, config.people), strict=True)
        return max(speeds), max(accelerations)
    match config.motion:
        case "none" | "still":
            return 0.0, 0.0
        case "random_walk" | "arc":
            jitter = max(math.sqrt(2) * config.jitter_m, config.forward_m) / CONTROL_STEP_S
            swing = math.radians(config.arc_deg) / (config.arc_steps * CONTROL_STEP_S) * FARTHEST_ARC_M
            return 2 * jitter + (swing if config.motion == "arc" else 0.0), math.inf
        case "recorded":
            assert config.file is not None
            return recorded_bounds(read_recordings(config.file))
        case name if name in STEERED and config.acceleration_m_s2 is not None:
            return config.speed_m_s, config.acceleration_m_s2
        case "approach" | "patrol":
            return 2 * config.speed_m_s, math.inf
        case "live":
            return config.speed_m_s, math.inf
    return math.inf, math.inf


FARTHEST_ARC_M = 2.0
"""Distance from the base within which the bound of `arc` holds."""
