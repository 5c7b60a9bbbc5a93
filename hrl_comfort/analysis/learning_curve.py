"""What the learning curve of a kind of training is: which of its columns it is drawn of, and how."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class LearningCurve:
    """How well a kind of training does against how far it is; both are columns of `file`."""

    file: str
    progress: str
    score: str
    scale: float
    """What the score is drawn times."""
    least: float
    most: float
    """Of the score, drawn."""
    label: str
    caption: str


POLICY = LearningCurve(
    "metrics.csv",
    progress="policy_steps",
    score="success",
    scale=100,
    least=0,
    most=100,
    label="training episodes that succeed (%)",
    caption="Training episodes that succeed, at the precision that the curriculum has reached by then.",
)
CONTROLLER = LearningCurve(
    "meta_controller_metrics.csv",
    progress="options",
    score="return",  # its skills succeed from the beginning: what is learnt is when to run which
    scale=1,
    least=-math.inf,
    most=math.inf,
    label="mean return of training episodes",
    caption="Mean return of training episodes, in which some options are chosen at random, ever fewer.",
)
CURVES = (POLICY, CONTROLLER)


def curve_of(metrics: Mapping[str, object]) -> LearningCurve:
    """Return the learning curve of a training whose log has these columns."""
    return next(each for each in CURVES if each.progress in metrics)
