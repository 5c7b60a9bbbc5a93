"""Smooth shapes of which furniture, gripper and person are made: lofts and rounded hulls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator
from scipy.spatial import ConvexHull

Array = NDArray[np.float64]
Colour = tuple[float, float, float, float]
"""(r, g, b, opacity), 0 to 1."""
AROUND, ALONG = 24, 26
"""Vertices of a ring, and rings of a loft."""


@dataclass(frozen=True)
class Part:
    """A mesh that is part of the picture of a body: V vertices (m, the body's frame) and F triangles."""

    body: str
    colour: Colour
    vertices: Array
    """(V, 3)"""
    faces: NDArray[np.int32]
    """(F, 3), counter-clockwise from outside."""

    def placed(self, body: str, offset_m: Sequence[float] = (0.0, 0.0, 0.0), mirrored: bool = False) -> Part:
        """Return the part on another body, moved, or mirrored at its plane y = 0 first."""
        vertices = self.vertices * (1.0, -1.0 if mirrored else 1.0, 1.0) + np.asarray(offset_m)
        return replace(self, body=body, vertices=vertices, faces=self.faces[:, ::-1] if mirrored else self.faces)


def loft(body: str, colour: Colour, rings: Sequence[Sequence[float]], power: float = 2.0, along: int = ALONG) -> Part:
    """Return the smooth skin of `rings` (z, x of the centre, half depth along x, half width along y), m, by rising z.

    `power` is the exponent of the superellipse: 2 is an ellipse, 4 almost a rectangle. First and last ring are closed.
    """
    table = np.asarray(rings, dtype=np.float64)
    at = np.linspace(0.0, len(table) - 1.0, along)
    z, centre, depth, width = PchipInterpolator(np.arange(len(table)), table)(at).T[..., None]
    angle = np.linspace(0.0, 2 * np.pi, AROUND, endpoint=False)
    cos, sin = (np.sign(v) * np.abs(v) ** (2 / power) for v in (np.cos(angle), np.sin(angle)))
    skin = np.stack([centre + depth * cos, width * sin, z + 0 * cos], axis=-1).reshape(-1, 3)
    ends = [[table[0][1], 0.0, table[0][0]], [table[-1][1], 0.0, table[-1][0]]]
    vertices = np.concatenate([skin, ends])
    low = np.arange(along - 1)[:, None] * AROUND + np.arange(AROUND)
    after = np.roll(low.reshape(along - 1, AROUND), -1, axis=1)
    sides = [np.stack([low, after, after + AROUND], -1), np.stack([low, after + AROUND, low + AROUND], -1)]
    first, top = np.arange(AROUND), (along - 1) * AROUND + np.arange(AROUND)
    caps = [
        np.stack([np.roll(first, -1), first, np.full(AROUND, len(skin))], -1),
        np.stack([top, np.roll(top, -1), np.full(AROUND, len(skin) + 1)], -1),
    ]
    faces = np.concatenate([each.reshape(-1, 3) for each in (*sides, *caps)])
    return Part(body, colour, vertices, faces.astype(np.int32))


def hull(body: str, colour: Colour, corners: ArrayLike, radius_m: float) -> Part:
    """Return the convex hull of balls of one radius at `corners` (C, 3), m."""
    ring = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
    height = np.linspace(-np.pi / 2, np.pi / 2, 7)[:, None]
    ball = np.stack([np.cos(height) * np.cos(ring), np.cos(height) * np.sin(ring), np.sin(height) + 0 * ring], axis=-1)
    points = (np.asarray(corners)[:, None] + radius_m * ball.reshape(-1, 3)).reshape(-1, 3)
    found = ConvexHull(points)
    inward = np.einsum(
        "fi,fi->f",
        np.cross(points[found.simplices[:, 1]] - points[found.simplices[:, 0]],
                 points[found.simplices[:, 2]] - points[found.simplices[:, 0]]),
        found.equations[:, :3],
    ) < 0  # fmt: skip
    simplices = np.where(inward[:, None], found.simplices[:, ::-1], found.simplices)
    used, faces = np.unique(simplices, return_inverse=True)
    return Part(body, colour, points[used], faces.reshape(-1, 3).astype(np.int32))


def block(body: str, colour: Colour, half_m: Sequence[float], centre_m: Sequence[float], radius_m: float) -> Part:
    """Return a box with rounded edges."""
    signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    return hull(body, colour, np.asarray(centre_m) + signs * (np.asarray(half_m) - radius_m), radius_m)


def turned(body: str, colour: Colour, profile: Sequence[tuple[float, float]]) -> Part:
    """Return the solid that a `profile` of (z, radius), m, makes when it turns about z, its edges sharp."""
    parts, count = [], 0
    angle = np.linspace(0.0, 2 * np.pi, 2 * AROUND, endpoint=False)
    around, faces = np.stack([np.cos(angle), np.sin(angle)], axis=-1), []
    first = np.arange(2 * AROUND)
    after = np.roll(first, -1)
    for (low, small), (high, large) in pairwise(profile):
        for z, radius in ((low, small), (high, large)):
            parts.append(np.column_stack([radius * around, np.full(2 * AROUND, z)]))
        above = first + 2 * AROUND, after + 2 * AROUND
        faces += [count + np.stack([first, after, above[1]], -1), count + np.stack([first, above[1], above[0]], -1)]
        count += 4 * AROUND
    return Part(body, colour, np.concatenate(parts), np.concatenate(faces).astype(np.int32))
