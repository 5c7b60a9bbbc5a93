"""Make docs/images/levels.gif: one episode at comfort levels 1 and 10, side by side, in slow motion.

hrl-comfort evaluate policy=runs/reference/comfort/seed0/pick_place 'levels=[1,10]' episodes=60 record=true \
    output=/tmp/levels
python docs/images/make_levels_gif.py /tmp/levels docs/images/levels.gif
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from PIL import Image, ImageDraw, ImageFont

from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.config.compose import load_config
from hrl_comfort.plots.video import FRAMES_PER_S, frames

EPISODE, LEVELS = 24, (1, 10)
CROP, COLOURS, FONT = (75, 8, 395, 338), 255, ImageFont.load_default(14)
FRAME_MS, HOLD = 100, 12
"""Duration of a frame (2.5 times slower than real time), and repetitions of the last one."""


def panels(folder: Path, level: int) -> list[Image.Image]:
    """Return the captioned pictures of the recorded episode at one level."""
    config = load_config(folder)
    episodes = pd.read_csv(folder / "episodes.csv").query("episode == @EPISODE and comfort_level == @level")
    path = pd.read_csv(folder / "paths.csv").query("episode == @EPISODE and level == @level").reset_index(drop=True)
    colour = str(episodes["colour"].item())
    pictures = []
    for index, picture in enumerate(frames(path, config.robot, config.cell, config.task.name, colour)):
        step = min(round(index / FRAMES_PER_S / CONTROL_STEP_S), len(path) - 1)
        image = Image.fromarray(picture).crop(CROP)
        said = f"level {level}    {step * CONTROL_STEP_S:.1f} s    {path['human_distance_m'][step]:.2f} m to the person"
        ImageDraw.Draw(image).text((10, 8), said, fill="white", font=FONT, stroke_width=2, stroke_fill="black")
        pictures.append(image)
    return pictures


def make(folder: Path, output: Path) -> None:
    """Write the animation of one recorded episode of `folder` to `output`."""
    sides = [panels(folder, level) for level in LEVELS]
    length = max(len(side) for side in sides) + HOLD
    images = []
    for index in range(length):
        both = np.hstack([np.asarray(side[min(index, len(side) - 1)]) for side in sides])
        images.append(Image.fromarray(both).quantize(COLOURS, dither=Image.Dither.NONE))
    images[0].save(output, save_all=True, append_images=images[1:], duration=FRAME_MS, loop=0, optimize=True)


if __name__ == "__main__":
    make(Path(sys.argv[1]), Path(sys.argv[2]))
