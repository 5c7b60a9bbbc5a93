"""Replays of a report: recorded episodes, failures first, that replay.js draws in the page itself.

Every moving body is a capsule or a sphere, so a picture is the ends of line segments with round caps, which a canvas
draws exactly in parallel projection: no WebGL, no library, a few kB a second of an episode.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S, FAR_AWAY_M, ConfigError
from hrl_comfort.files.run_folder import Run
from hrl_comfort.files.tables import column
from hrl_comfort.plots.clip import set_pose
from hrl_comfort.plots.tape import Recording, Take, Tape
from hrl_comfort.plots.video import azimuth_deg

OF_A_KIND = 3
"""Most failures and most successes of a run."""
STRIDE, MOST_FRAMES = 4, 600
"""Control steps between two pictures, more in an episode that would have more pictures than that."""
MOST_BYTES = 2_000_000
"""Size of all pictures of a page."""
FARTHEST_MM = 30_000
"""A point farther away is not drawn."""
_SHAPE = mujoco.mjtGeom
_ROUND = (_SHAPE.mjGEOM_SPHERE, _SHAPE.mjGEOM_CAPSULE, _SHAPE.mjGEOM_CYLINDER)
_FACES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
"""Corners of a box, counter-clockwise from outside; bit 2 of a corner is x, bit 1 y, bit 0 z."""
_CORNERS = np.array([[2 * (index >> bit & 1) - 1 for bit in (2, 1, 0)] for index in range(8)])


def replays(runs: Sequence[Run]) -> tuple[dict[str, Any] | None, str]:
    """Return what replay.js draws, of the last run first (the cycle), and why there is nothing."""
    scenes: list[dict[str, Any]] = []
    episodes: list[dict[str, Any]] = []
    why, left = "No replay: it needs eval/paths.csv (evaluate with record=true) and config.yaml.", MOST_BYTES
    for run in reversed(runs):
        if run.paths is None:
            continue
        try:
            tape = Tape(run)
        except ConfigError as error:
            why = f"No replay: {error}"
            continue
        shapes = Shapes(tape)
        scenes.append(shapes.still())
        for recording in chosen(tape):
            takes = [shapes.take(take) for take in recording.ends]
            left -= sum(len(take["frames"]) for take in takes)
            if left < 0 and episodes:
                return _page(scenes, episodes), ""
            azimuth = math.radians(azimuth_deg(recording.takes[0].path))
            title = f"{run.name}, {recording.title}"
            episodes.append({"title": title, "scene": len(scenes) - 1, "azimuth": azimuth, "takes": takes})
    return (_page(scenes, episodes), "") if episodes else (None, why)


def _page(scenes: list[dict[str, Any]], episodes: list[dict[str, Any]]) -> dict[str, Any]:
    """Return what replay.js draws, and what the caption says: the quantities over time, and whether levels differ."""
    takes = [take for episode in episodes for take in episode["takes"]]
    names = list(dict.fromkeys(name for take in takes for name in take["series"]))
    return {"scenes": scenes, "episodes": episodes, "series": names, "levels": len(takes) > len(episodes)}


def series(take: Take, rows: Sequence[int]) -> dict[str, NDArray[np.float64]]:
    """Return quantities over time by their label, (frames,): the worst value from each picture to the next.

    A person who is not there has no distance, an arm without a shield no share of the speed that it passes.
    """
    found = {}
    distance = column(take.path, "human_distance_m")
    if (distance < FAR_AWAY_M / 2).all():
        found["horizontal distance to the person (m)"] = np.minimum.reduceat(distance, rows)
    speed = np.linalg.norm(np.diff(take.tool, axis=0, prepend=take.tool[:1]), axis=1) / CONTROL_STEP_S
    found["speed of the tool (m/s)"] = np.maximum.reduceat(speed, rows)
    if take.tape.run.config.get("safety", {}).get("kind", "none") != "none":
        share = np.nan_to_num(column(take.path, "shield_share"), nan=1.0)
        found["speed that the shield passes (%)"] = np.minimum.reduceat(100 * share, rows)
    return found


def chosen(tape: Tape) -> list[Recording]:
    """Return the first recordings with a failure, then the first without."""
    kinds = [[each for each in tape.recordings if each.success == success][:OF_A_KIND] for success in (False, True)]
    return kinds[0] + kinds[1]


class Shapes:
    """Geoms and sites of a cell as line segments and faces.

    Args:
      tape: whose cell it is.
    """

    def __init__(self, tape: Tape) -> None:
        self._scene, self._data = tape.scene, mujoco.MjData(tape.scene.model)
        model = self._model = tape.scene.model
        mujoco.mj_kinematics(model, self._data)
        self._kinds = np.concatenate([model.geom_type, model.site_type])
        self._sizes = np.concatenate([model.geom_size, model.site_size])
        self._colours = np.concatenate([model.geom_rgba, model.site_rgba])
        bodies = np.concatenate([model.geom_bodyid, model.site_bodyid])
        names = [model.geom(k).name for k in range(model.ngeom)] + [model.site(k).name for k in range(model.nsite)]
        shown = (self._colours[:, 3] > 0) & [not name.startswith("robot/tcp") for name in names]
        moves = (model.body_weldid[bodies] > 0) | (model.body_mocapid[bodies] >= 0)
        rounds = shown & np.isin(self._kinds, _ROUND)
        self._moving, self._still = np.flatnonzero(rounds & moves), np.flatnonzero(rounds & ~moves)
        self._boxes = np.flatnonzero(shown & (self._kinds == _SHAPE.mjGEOM_BOX))

    def still(self) -> dict[str, Any]:
        """Return what does not move, the looks of what does, and the height of the floor, mm."""
        return {
            "floor": round(1000 * self._scene.floor_z),
            "faces": [face for box in self._boxes for face in self._faces(box)],
            "still": [
                [*look, *line]
                for look, line in zip(self._looks(self._still), self._lines(self._still).tolist(), strict=True)
            ],
            "moving": self._looks(self._moving),
        }

    def take(self, take: Take) -> dict[str, Any]:
        """Return the pictures of a take: int16 (frames, moving + 1, 6) mm as base64; the last row is tool and person.

        A line is its two ends; the last is the tool centre point and the person's place on the floor.
        """
        clip, length = take.clip, len(take.path)
        stride = max(STRIDE, math.ceil(length / MOST_FRAMES))
        rows = [*range(0, length - 1, stride), length - 1]
        frames = np.empty((len(rows), len(self._moving) + 1, 6), dtype="<i2")
        for frame, row in enumerate(rows):
            set_pose(self._data, self._scene, clip.frame(clip.time[row]))
            frames[frame, :-1] = self._lines(self._moving)
            frames[frame, -1] = millimetres([*take.tool[row], *clip.person[row, :2], clip.floor_z])
        return {
            "title": take.title,
            "times": [round(float(row * CONTROL_STEP_S), 2) for row in rows],
            "frames": base64.b64encode(frames.tobytes()).decode("ascii"),
            "series": {name: np.round(values, 3).tolist() for name, values in series(take, rows).items()},
        }

    def _looks(self, shapes: NDArray[np.intp]) -> list[list[Any]]:
        """Return radius, mm, and colour (0 to 255, opacity) of each round shape."""
        return [[*millimetres(self._sizes[shape, :1]).tolist(), self._colour(shape)] for shape in shapes]

    def _colour(self, shape: np.intp) -> list[float]:
        *rgb, opacity = self._colours[shape].tolist()
        return [*(round(255 * value) for value in rgb), round(opacity, 2)]

    def _lines(self, shapes: NDArray[np.intp]) -> NDArray[np.int16]:
        """Return the ends (S, 6), mm, of the axis of each round shape."""
        places, turns = self._poses()
        half = np.where(self._kinds[shapes] == _SHAPE.mjGEOM_SPHERE, 0.0, self._sizes[shapes, 1])[:, None]
        axes = half * turns[shapes].reshape(-1, 3, 3)[:, :, 2]
        return millimetres(np.concatenate([places[shapes] - axes, places[shapes] + axes], axis=1))

    def _faces(self, box: np.intp) -> list[list[Any]]:
        """Return the faces of a box, each a colour and four corners, mm, counter-clockwise from outside."""
        places, turns = self._poses()
        corners = millimetres(places[box] + (_CORNERS * self._sizes[box]) @ turns[box].reshape(3, 3).T)
        return [[self._colour(box), corners[face].tolist()] for face in _FACES]

    def _poses(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        data = self._data
        return np.concatenate([data.geom_xpos, data.site_xpos]), np.concatenate([data.geom_xmat, data.site_xmat])


def millimetres(metres: Any) -> NDArray[np.int16]:
    """Return lengths in mm; what is not finite or farther than FARTHEST_MM becomes a little more than that."""
    most = (FARTHEST_MM + 1) / 1000
    values = np.clip(np.nan_to_num(metres, nan=most, posinf=most, neginf=-most), -most, most)
    return np.round(1000 * values).astype("<i2")
