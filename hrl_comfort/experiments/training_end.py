"""How a training did at its end: the rows of metrics.csv of the last tenth of its decisions."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hrl_comfort.experiments.statistics import Floats

LAST = 0.1
MEANS = ("success", "return", "steps")


def training_end(metrics: Mapping[str, Floats]) -> dict[str, float]:
    """Return the means of success, return and steps over the episodes of the end, and the precision then.

    Args:
      metrics: the columns of metrics.csv, each (n,); a row is the mean of the episodes since the last one.

    Returns:
      `success` (0 to 1), `return`, `steps` (control steps), `precision_m`; what no episode tells is left out.
    """
    late = metrics["decisions"] > (1 - LAST) * metrics["decisions"][-1]
    episodes = np.diff(metrics["episodes"], prepend=0.0)
    found = {"precision_m": float(metrics["precision_m"][-1])}
    for name in MEANS:
        there = late & np.isfinite(metrics[name]) & (episodes > 0)
        if there.any():
            found[name] = float(np.average(metrics[name][there], weights=episodes[there]))
    return found
