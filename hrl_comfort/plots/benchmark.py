"""Figure of the benchmark: throughput against discomfort."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hrl_comfort.plots.style import BLACK, CYCLE, OUTLINE, around, of_estimates, styled

MARKERS = "osD^v"
"""One for each round of colours."""


def front(entries: Sequence[Mapping[str, Any]]) -> Figure:
    """Draw objects over discomfort a minute, a line a policy and a point a level, with 95 % intervals.

    A cross marks levels with unsafe contacts; a star and a dashed line, entries of another suite.
    """
    with styled():
        figure = Figure(figsize=(5.6, 3.8))
        axis = figure.subplots()
        colours = (*CYCLE, BLACK)
        for number, (entry, colour) in enumerate(zip(entries, cycle(colours), strict=False)):
            levels = entry["levels"]
            y, x = (of_estimates([at[name] for at in levels]) for name in ("objects_per_min", "discomfort_per_min"))
            label = entry["policy"] + "*" * bool(entry["changed"])
            marker = MARKERS[number // len(colours) % len(MARKERS)]
            look: dict[str, Any] = {"marker": marker, "markersize": 4, "capsize": 2, "color": colour, "label": label}
            look["linestyle"] = "--" if entry["changed"] else "-"
            axis.errorbar(x[0], y[0], around(*y), around(*x), elinewidth=0.7, **look)
            unsafe = np.array([at["unsafe_contacts_per_h"]["mean"] > 0 for at in levels])
            axis.plot(x[0][unsafe], y[0][unsafe], "X", color="white", markeredgecolor=colour, markersize=9, zorder=3)
            for at, place in zip(levels, zip(x[0], y[0], strict=True), strict=True):
                above: dict[str, Any] = {"xytext": (0, 6), "textcoords": "offset points", "ha": "center"}
                axis.annotate(str(at["level"] or ""), place, color=colour, size=7.5, path_effects=[OUTLINE], **above)
        axis.set(title="Throughput against discomfort", xlabel="discomfort (s a minute)", ylabel="objects a minute")
        figure.legend(loc="outside lower center", ncols=2)
        return figure
