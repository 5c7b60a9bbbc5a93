"""The learning curve of a training: its columns, its labels, and the numbers at its end."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pandas import DataFrame

from hrl_comfort.files.tables import column

LAST = 0.1
"""Share of a training, at its end, that the final numbers are means over."""
MEANS = ("success", "return", "steps", "placed")


@dataclass(frozen=True)
class LearningCurve:
    """A score against the progress of a kind of training; both are columns of its log."""

    progress: str
    score: str
    scale: float
    """Factor of the score as drawn."""
    least: float
    most: float
    """Bounds of the score as drawn."""
    label: str
    caption: str


POLICY = LearningCurve(
    progress="policy_steps",
    score="success",
    scale=100,
    least=0,
    most=100,
    label="training episodes that succeed (%)",
    caption="Training episodes that succeed, at the precision that the curriculum has reached by then.",
)
CONTROLLER = LearningCurve(
    progress="options",
    score="return",  # its skills succeed from the beginning: it learns when to run which
    scale=1,
    least=-math.inf,
    most=math.inf,
    label="mean return of training episodes",
    caption="Mean return of training episodes, in which some options are chosen at random, ever fewer.",
)


def curve_of(metrics: DataFrame) -> LearningCurve:
    """Return the learning curve of a training by the columns of its log."""
    return POLICY if POLICY.progress in metrics else CONTROLLER


def training_end(metrics: DataFrame) -> dict[str, float]:
    """Return the means of success, return, steps and objects placed over the last tenth, and the last precision.

    A row of the log is the mean of the episodes since the row before, and weighs as much as they are. A
    quantity without a value is left out.
    """
    curve = curve_of(metrics)
    progress, episodes = column(metrics, curve.progress), column(metrics, "episodes")
    late = progress > (1 - LAST) * progress[-1]
    # A controller's rows count the episodes since the row before, a policy's those so far.
    weights = np.diff(episodes, prepend=0.0) if curve is POLICY else episodes
    found = {"precision_m": float(metrics["precision_m"].iloc[-1])} if "precision_m" in metrics else {}
    for name in MEANS:
        values = column(metrics, name)
        there = late & np.isfinite(values) & (weights > 0)
        if there.any():
            found[name] = float(np.average(values[there], weights=weights[there]))
    return found
