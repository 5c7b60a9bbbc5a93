"""How a training did at its end: the rows of its metrics of the last tenth of its decisions, or options."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hrl_comfort.analysis.intervals import Floats
from hrl_comfort.analysis.learning_curve import POLICY, curve_of

LAST = 0.1
MEANS = ("success", "return", "steps", "placed")


def training_end(metrics: Mapping[str, Floats]) -> dict[str, float]:
    """Return the means of success, return, steps and balls placed at the end, and the precision then.

    Args:
      metrics: the columns of metrics.csv or meta_controller_metrics.csv, each (n,); a row is the mean of the episodes
        since the last one.

    Returns:
      `success` (0 to 1), `return`, `steps` (control steps), `placed` (a controller's balls), `precision_m`;
      what no episode or column tells is left out.
    """
    curve = curve_of(metrics)
    late = metrics[curve.progress] > (1 - LAST) * metrics[curve.progress][-1]
    # A controller's rows count the episodes since the last one, a policy's those so far.
    episodes = np.diff(metrics["episodes"], prepend=0.0) if curve is POLICY else metrics["episodes"]
    found = {"precision_m": float(metrics["precision_m"][-1])} if "precision_m" in metrics else {}
    for name in MEANS:
        if name not in metrics:
            continue
        there = late & np.isfinite(metrics[name]) & (episodes > 0)
        if there.any():
            found[name] = float(np.average(metrics[name][there], weights=episodes[there]))
    return found
