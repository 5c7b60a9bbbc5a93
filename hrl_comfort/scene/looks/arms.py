"""Meshes of the UR arms in the frames of their links; `make_arms` makes them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hrl_comfort.scene.looks.shapes import Part

FOLDER = Path(__file__).parent
ARMS_LICENCE = FOLDER / "ARMS_LICENSE.txt"
ARMS = ("ur3e", "ur5e")
"""Arms with meshes."""
UNIT_M = 2e-5
"""Unit of the vertices in the files."""
COLOURS = {
    "link": (0.80, 0.82, 0.84, 1.0),
    "cap": (0.42, 0.60, 0.74, 1.0),
    "joint": (0.46, 0.48, 0.50, 1.0),
    "black": (0.12, 0.12, 0.13, 1.0),
}
"""By material."""


def arm_parts(name: str) -> Iterator[Part]:
    """Yield the parts of the arm `name`, none of one without meshes."""
    if name not in ARMS:
        return
    with np.load(FOLDER / f"{name}.npz") as stored:
        for key in stored.files:
            body, kind, array = key.split(".")
            if array == "vertices":
                faces = stored[f"{body}.{kind}.faces"].astype(np.int32)
                yield Part(f"robot/{body}", COLOURS[kind], stored[key] * UNIT_M, faces)
