"""Draw docs/comfort_forms.png: every form of F_conf1 against distance, from the code that pays it.

python docs/comfort_forms.py
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib
import torch

matplotlib.use("Agg")
from matplotlib import pyplot as plt

from hrl_comfort.comfort.terms import FORMS, THRESHOLDS, TIMED, distance_term
from hrl_comfort.config.compose import compose

LEVELS = (1, 4, 7, 10)
STYLES = dict(zip(LEVELS, ("-", "--", "-.", ":"), strict=True))
COLOURS = dict(zip(LEVELS, ("#440154", "#31688e", "#35b779", "#d9a400"), strict=True))
"""Dark to light, as in viridis; the style of the line tells them apart too."""
THRESHOLD = {"reference": "reference", **dict.fromkeys(TIMED, "levels")}
"""Threshold of a form; the others take `range`, which fits the paper's example."""


def draw(output: Path) -> None:
    """Draw a panel a form, all with the same axes."""
    config = compose("train", ["comfort=conditioned"]).comfort
    distance = torch.linspace(0.005, 1.5, 300, dtype=torch.float64)
    figure, axes = plt.subplots(2, 4, figsize=(11, 5.7), sharex=True, sharey=True, layout="constrained")
    for axis, form in zip(axes.flat, FORMS, strict=False):
        chosen = replace(config, form=form, threshold=THRESHOLD.get(form, "range"))
        axis.axhline(0, color="0.6", linewidth=0.8)
        for level in LEVELS:
            row = torch.full_like(distance, level)
            value = distance_term(distance, row, chosen)
            axis.plot(distance, value, STYLES[level], color=COLOURS[level], linewidth=1.8)
            theta = THRESHOLDS[chosen.threshold](row[:1], chosen)
            if theta > 0:
                mark = distance_term(theta, row[:1], chosen)
                axis.plot(theta, mark, "o", color=COLOURS[level], markersize=5)
        axis.set_title(f"form={form}\nthreshold={chosen.threshold}", fontsize=9)
        axis.set(xlim=(0, 1.5), ylim=(-1.5, 1.3), xticks=(0, 0.5, 1, 1.5))
        axis.tick_params(labelbottom=True, labelleft=True)
    for axis in axes.flat[len(FORMS) :]:
        axis.remove()
    handles = [plt.Line2D([], [], linestyle=STYLES[k], color=COLOURS[k], label=f"level {k}") for k in LEVELS]
    handles.append(plt.Line2D([], [], linestyle="", marker="o", color="0.3", label="threshold θ"))
    figure.legend(handles=handles, loc="outside upper center", ncols=5, frameon=False)
    figure.supxlabel("distance d (m)")
    figure.supylabel("$F_{conf1}$ (reward per control step, before comfort.scale)", fontsize=10)
    figure.savefig(output, dpi=110)


if __name__ == "__main__":
    draw(Path(__file__).with_suffix(".png"))
