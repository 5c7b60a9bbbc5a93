"""A person whose rating of comfort is fitted to published figures: `comfort.source=fitted`.

With d the distance between the centres of robot and person and v the speed of the tool, people rate their comfort as

    rating = top + offset - (at_rest + by_speed v^exponent) exp(-d^2 / (2 width^2)), from 1 to 7.

The inverted Gaussian in d is the form of Neggers et al. (2022). `offset` is a person's own, normally distributed.
`comfort.fit` fits the constants to `published.yaml`, which has the sources; docs/comfort.md has their scope.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.config import CONTROL_STEP_S

LOWEST, HIGHEST = 1.0, 7.0
"""Ends of the scale of the ratings."""
BODY_M = 0.44
"""Centre distance less the distance between surfaces, m: half the width of a robot and of a person, 0.22 m each. An
assumption: it carries the figures of a mobile robot over to the links of an arm."""
PERSONS = 1000
"""Size of the population. Splits have shares of it: see `humans.persons_of`."""


@dataclass(frozen=True)
class Constants:
    """Constants of the model, in points of the scale unless said."""

    top: float
    """Rating of a robot far away."""
    at_rest: float
    by_speed: float
    """Points per (m/s)^exponent."""
    width_m: float
    exponent: float
    """Exponent of the speed; no unit."""
    spread: float
    """Standard deviation of the offsets of persons."""


FITTED = Constants(top=6.1796, at_rest=4.0446, by_speed=2.8419, width_m=0.35015, exponent=2.2568, spread=0.5066)


def expected(centre_distance: Tensor, speed: Tensor, constants: Constants = FITTED) -> Tensor:
    """Return the mean rating over people at centre distances, m, and speeds, m/s, that broadcast; it has no bounds."""
    near = torch.exp(-(centre_distance**2) / (2 * constants.width_m**2))
    return constants.top - (constants.at_rest + constants.by_speed * speed**constants.exponent) * near


def offsets(person: Tensor) -> Tensor:
    """Return the offsets of persons, int64 below PERSONS, in points.

    They are quantiles of a normal distribution in the order of the golden ratio, so that any run of persons, and with
    it each split, has nearly its mean and spread.
    """
    golden = (np.sqrt(5) - 1) / 2
    return FITTED.spread * torch.special.ndtri(((person.double() + 0.5) * golden) % 1.0)


def rating(arm_distance: Tensor, speed: Tensor, person: Tensor) -> Tensor:
    """Return the ratings of persons at arm distances, m, and tool speeds, m/s, that broadcast."""
    mean = expected((arm_distance + BODY_M).clamp(min=0.0), speed)
    return (mean + offsets(person)).clamp(LOWEST, HIGHEST)


def mean_rating(arm_distance: NDArray[np.float64], tool: NDArray[np.float64], person: int) -> float:
    """Return a person's mean rating over an episode: `arm_distance` (T + 1,) m and `tool` (T + 1, 3) m."""
    speed = np.linalg.norm(np.diff(tool, axis=0), axis=-1) / CONTROL_STEP_S
    return float(rating(torch.from_numpy(arm_distance[1:]), torch.from_numpy(speed), torch.tensor(person)).mean())


def level_of(rated: Tensor, levels: int) -> Tensor:
    """Return the levels of ratings, whole numbers: the scale of the ratings is spread over 1 to N_c."""
    return torch.round(1 + (levels - 1) * (rated - LOWEST) / (HIGHEST - LOWEST))
