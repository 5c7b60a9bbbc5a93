"""Pictures of the pages that no other command draws: `python -m hrl_comfort.results.pictures KIND [FOLDER] OUTPUT`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import imageio.v3 as imageio
import mujoco
import numpy as np
import torch
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from pandas import concat
from PIL import Image, ImageDraw, ImageFont

from hrl_comfort.analysis.mixes import WORK
from hrl_comfort.benchmarks.entries import ENTRIES, committed
from hrl_comfort.comfort.terms import FORMS, THRESHOLDS, TIMED, distance_term
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import CONTROL_STEP_S, ConfigError, TrainConfig
from hrl_comfort.files.run_folder import read_run
from hrl_comfort.files.tables import read_table
from hrl_comfort.plots.benchmark import X, front, levels_of
from hrl_comfort.plots.clip import set_pose
from hrl_comfort.plots.style import save_png
from hrl_comfort.plots.tape import Take, Tape
from hrl_comfort.plots.video import FRAMES_PER_S, azimuth_deg, frames
from hrl_comfort.scene.looks import dressed

LEVELS, LEAST_STEPS = (1, 10), 60
"""Shown by `levels`, and how long its episode lasts at least, control steps."""
CROP, PALETTE, FONT = (75, 8, 395, 338), 255, ImageFont.load_default(14)
FRAME_MS, HOLD = 100, 12
"""Duration of a frame (2.5 times slower than real time), and repetitions of the last one."""
STAGE, SHARE, WIDTH, HEIGHT = 1, 0.65, 1000, 620
"""The stage shown by `cell`, 1: the object is carried; the share of it that has gone by; and the picture's size."""
DOTS = ((0.15, 0.45, 0.9, 1), (1.0, 0.5, 0.1, 1), (0.3, 0.65, 0.3, 1))
"""Colours of the tool's path: to the object, with it, home."""
LINES = {1: ("-", "#440154"), 4: ("--", "#31688e"), 7: ("-.", "#35b779"), 10: (":", "#d9a400")}
"""Style and colour of a level, dark to light."""


def levels(folder: Path, output: Path) -> None:
    """Write the animation of one recorded episode of `folder`, at LEVELS side by side.

    It is the one, of those that succeed at both, in which the mean distance to the person differs most.
    """
    episodes, tape = read_table(folder / "episodes.csv"), Tape(read_run(folder))
    assert episodes is not None
    good = episodes[episodes["success"] & (episodes["steps"] >= LEAST_STEPS)]
    distance = good.pivot(index="episode", columns="comfort_level", values="human_distance_mean_m")
    number = int((distance[LEVELS[0]] - distance[LEVELS[1]]).idxmax())
    takes = next(each.takes for each in tape.recordings if each.episode == number)
    view_deg = azimuth_deg(concat(take.path for take in takes))
    sides = [panels(take, view_deg) for take in takes if take.level in LEVELS]
    length = max(len(side) for side in sides) + HOLD
    images = []
    for index in range(length):
        both = np.hstack([np.asarray(side[min(index, len(side) - 1)]) for side in sides])
        images.append(Image.fromarray(both).quantize(PALETTE, dither=Image.Dither.NONE))
    images[0].save(output, save_all=True, append_images=images[1:], duration=FRAME_MS, loop=0, optimize=True)


def panels(take: Take, view_deg: float) -> list[Image.Image]:
    """Return the captioned pictures of a recorded episode at one level, seen from this azimuth."""
    distance_m, pictures = take.path["human_distance_m"], []
    for index, picture in enumerate(frames(take, view_deg=view_deg)):
        step = min(round(index / FRAMES_PER_S / CONTROL_STEP_S), len(distance_m) - 1)
        image = Image.fromarray(picture).crop(CROP)
        said = f"level {take.level}    {step * CONTROL_STEP_S:.1f} s    {distance_m[step]:.2f} m to the person"
        ImageDraw.Draw(image).text((10, 8), said, fill="white", font=FONT, stroke_width=2, stroke_fill="black")
        pictures.append(image)
    return pictures


def cell(folder: Path, output: Path) -> None:
    """Draw the second recorded episode of `folder` while an object is carried, the tool's path as dots."""
    take = next(each for each in Tape(read_run(folder)).recordings if each.episode == 1).takes[0]
    scene, stages = dressed(take.tape.scene), take.path["stage"]
    model, data = scene.model, mujoco.MjData(scene.model)
    model.vis.global_.offwidth, model.vis.global_.offheight = WIDTH, HEIGHT
    model.vis.quality.offsamples = 8
    carried = np.flatnonzero(stages == STAGE)
    now = int(carried[int(SHARE * (len(carried) - 1))])
    set_pose(data, scene, take.clip.frame(take.clip.time[now]))
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = (0.05, 0.12, 0.15)
    camera.distance, camera.azimuth, camera.elevation = 2.9, 62, -22
    with mujoco.Renderer(model, HEIGHT, WIDTH) as renderer:
        renderer.update_scene(data, camera)
        for place, stage in zip(take.tool, stages, strict=True):
            dot = renderer.scene.geoms[renderer.scene.ngeom]
            colour = np.array(DOTS[min(int(stage), 2)], dtype=np.float32)
            mujoco.mjv_initGeom(dot, mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, 0.008), place, np.eye(3).ravel(), colour)
            renderer.scene.ngeom += 1
        imageio.imwrite(output, renderer.render())


def forms(output: Path) -> None:
    """Draw every form of the comfort term against distance, a panel a form, from the code that pays it."""
    training = compose("train", ["comfort=conditioned"])
    assert isinstance(training, TrainConfig)
    distance = torch.linspace(0.005, 1.5, 300, dtype=torch.float64)
    figure = Figure(figsize=(11, 5.7), layout="constrained")
    axes = figure.subplots(2, 4, sharex=True, sharey=True)
    for axis, form in zip(axes.flat, FORMS, strict=False):
        threshold = {"reference": "reference", **dict.fromkeys(TIMED, "levels")}.get(form, "range")
        chosen = replace(training.comfort, form=form, threshold=threshold)
        axis.axhline(0, color="0.6", linewidth=0.8)
        for level, (style, colour) in LINES.items():
            row = torch.full_like(distance, level)
            axis.plot(distance, distance_term(distance, row, chosen), style, color=colour, linewidth=1.8)
            theta = THRESHOLDS[chosen.threshold](row[:1], chosen)
            if theta > 0:
                axis.plot(theta, distance_term(theta, row[:1], chosen), "o", color=colour, markersize=5)
        axis.set_title(f"form={form}\nthreshold={chosen.threshold}", fontsize=9)
        axis.set(xlim=(0, 1.5), ylim=(-1.5, 1.3), xticks=(0, 0.5, 1, 1.5))
        axis.tick_params(labelbottom=True, labelleft=True)
    for axis in axes.flat[len(FORMS) :]:
        axis.remove()
    handles = [
        Line2D([], [], linestyle=style, color=colour, label=f"level {k}") for k, (style, colour) in LINES.items()
    ]
    handles.append(Line2D([], [], linestyle="", marker="o", color="0.3", label="threshold θ"))
    figure.legend(handles=handles, loc="outside upper center", ncols=5, frameon=False)
    figure.supxlabel("distance d (m)")
    figure.supylabel("$F_{conf1}$ (reward per control step, before comfort.scale)", fontsize=10)
    figure.savefig(output, dpi=110)


def benchmark(output: Path) -> None:
    """Draw the entries of the benchmark; raise ConfigError if none has what the figure shows."""
    entries = list(committed(ENTRIES).values())
    if not any(levels_of(entries, part) for part in WORK):
        raise ConfigError(f"no entry in {ENTRIES} has {X}; measure them again")
    save_png(front(entries), output)


KINDS: dict[str, Callable[..., None]] = {"levels": levels, "cell": cell, "forms": forms, "benchmark": benchmark}


if __name__ == "__main__":
    KINDS[sys.argv[1]](*map(Path, sys.argv[2:]))
