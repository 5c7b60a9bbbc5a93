"""Fit of the fitted person's constants to published figures; `python -m hrl_comfort.comfort.fit` prints them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import spearmanr

from hrl_comfort.comfort.fitted import FITTED, HIGHEST, LOWEST, Constants, expected
from hrl_comfort.files.reading import read_text

Floats = NDArray[np.float64]
KNOTS_M = (0.0, 0.5, 1.0, 2.0, 3.0)
"""Ends of the pieces of the curve that persons have in common."""


@dataclass(frozen=True)
class Ratings:
    """Ratings (n,) by several persons."""

    person: NDArray[np.int64]
    distance_m: Floats
    """Distance between the centres of the robot and of the nearest person."""
    share: Floats
    """Score as a share of the scale, 0 to 1."""


def published() -> dict[str, Any]:
    """Return the published figures by source (`published.yaml`)."""
    figures: dict[str, Any] = yaml.safe_load(read_text(Path(__file__).with_name("published.yaml")))
    return figures


def ratings(figures: dict[str, Any]) -> Ratings:
    """Return the ratings of single persons."""
    rows = [(person, *row) for person, each in enumerate(figures["persons"]["ratings"].values()) for row in each]
    person, score, x, y = np.array(rows, dtype=np.float64).T
    return Ratings(person.astype(np.int64), np.hypot(x, y) / 100, score / 100)


def fit(figures: dict[str, Any]) -> Constants:
    """Return the constants: exponent by `arm_speed`, then curve by `distance_and_speed`, and spread by `persons`.

    An exponent needs neither the length of the arm nor a common scale, so that it can be carried over.
    """
    exponent = arm_speed(figures)[0]
    passing = figures["distance_and_speed"]
    distance, speed = (torch.tensor(passing[name], dtype=torch.float64) for name in ("distance_m", "speed_m_s"))
    comfort = np.array(passing["comfort"])

    def missed(curve: Floats) -> Floats:
        constants = Constants(curve[0], curve[1], curve[2], curve[3], exponent, spread=0.0)
        return (expected(distance[:, None], speed, constants).numpy() - comfort).ravel()

    top, at_rest, by_speed, width_m = least_squares(missed, [6.0, 4.0, 3.0, 0.4]).x.tolist()
    points = (HIGHEST - LOWEST) * spread(ratings(figures))
    return Constants(top, at_rest, by_speed, width_m, exponent, points)


def arm_speed(figures: dict[str, Any]) -> tuple[float, Floats]:
    """Return the exponent p of a + b speed^p, common to surprise and fear, and these as fitted (2, speeds)."""
    arm = figures["arm_speed"]
    speed, felt = np.array(arm["speed_deg_s"]) / arm["speed_deg_s"][0], np.array([arm["surprise"], arm["fear"]])

    def curves(x: Floats) -> Floats:
        return x[:2, None] + x[2:4, None] * speed ** x[4]

    found = least_squares(lambda x: (curves(x) - felt).ravel(), [1.0, 1.0, 0.1, 0.1, 2.0]).x
    return float(found[4]), curves(found)


def spread(rated: Ratings) -> float:
    """Return the standard deviation between persons, as a share of the scale.

    Least squares on a curve of the distance that is linear between KNOTS_M and common to all, and an offset of each
    person; the variance of the offsets less that of their error (method of moments).
    """
    own = np.eye(rated.person.max() + 1)[rated.person]
    pieces = [np.clip(rated.distance_m - low, 0, high - low) for low, high in pairwise(KNOTS_M)]
    known = np.column_stack([own, *pieces])
    found, people = np.linalg.lstsq(known, rated.share)[0], own.shape[1]
    error = rated.share - known @ found
    covariance = error @ error / (len(error) - known.shape[1]) * np.linalg.inv(known.T @ known)[:people, :people]
    centred = np.eye(people) - 1 / people
    between = (found[:people] @ centred @ found[:people] - np.trace(centred @ covariance)) / (people - 1)
    return float(np.sqrt(max(between, 0.0)))


def held_out(figures: dict[str, Any], constants: Constants = FITTED) -> dict[str, float]:
    """Return how `constants` predict the distances of `persons`, which the curve is not fitted to.

    Spearman's rank correlation; mean and root mean square of prediction less rating, as shares of the scale.
    """
    rated = ratings(figures)
    mean = expected(torch.from_numpy(rated.distance_m), torch.zeros(1), constants).numpy()
    error = (mean - LOWEST) / (HIGHEST - LOWEST) - rated.share
    correlation = float(spearmanr(mean, rated.share).statistic)
    return {"rank_correlation": correlation, "bias": float(error.mean()), "rmse": float(np.sqrt((error**2).mean()))}


if __name__ == "__main__":
    given = published()
    print(asdict(fit(given)), held_out(given))
