"""Replay: recorded episodes of an evaluation, failures first, on a page with a time line to scrub."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from hrl_comfort.config import FAR_AWAY_M, ConfigError, StudioConfig
from hrl_comfort.files.run_folder import read_run
from hrl_comfort.plots.clip import Array
from hrl_comfort.plots.tape import Recording, Tape
from hrl_comfort.studio.loop import Loop
from hrl_comfort.studio.page import APART_M, Page, add_slider, set_camera
from hrl_comfort.studio.text import Text, columns, warning
from hrl_comfort.studio.view import CellView

PIECE_S = 0.1
"""Time between two decisions of the loop, of which a replay makes none."""
TOOL_RGB, PERSON_RGB = (230, 120, 20), (60, 100, 170)
TRAIL_HEIGHT_M = 0.01
SLIDER_S = 0.2
"""Time between two updates of the time line while it plays, s."""


def tape(folder: Path) -> Tape:
    """Return the tape of an evaluation, or of a run with one in `eval/`.

    Raises:
      ConfigError: there is no such folder, or it holds no recording.
    """
    if not folder.is_dir():
        raise ConfigError(f"replay={str(folder)!r} is not a folder")
    return Tape(read_run(folder))


class ReplayStudio:
    """A running replay; the levels of an episode are played side by side.

    Args:
      config: of the folder to play and of the page.
    """

    def __init__(self, config: StudioConfig) -> None:
        self.tape = tape(Path(config.replay or ""))
        self.page = Page(config.host, config.port, self.tape.run.name)
        self.views = [
            CellView(self.page, self.tape.scene, f"cell_{index}", (APART_M * index, 0.0, 0.0))
            for index in range(self.tape.cells)
        ]
        self._trails: list[Any] = []
        self.loop = Loop(self, config.frames_per_s, config.speed)
        set_camera(self.page, self.tape.cells)
        self.position_s, self._piece_s, self._drawn = 0.0, 0.0, 0.0
        self._titles = {each.title: each for each in self.tape.recordings}
        gui = self.page.gui
        self._status = Text(gui, "readout")
        self._run = gui.add_button("Pause")
        ask, set_speed = self.loop.ask, self.loop.set_speed
        self.time_line = add_slider(gui, "time (s)", (0.0, 1.0), 0.02, 0.0, lambda at: ask(lambda: self.scrub(at)))
        add_slider(gui, "speed (×)", (0.1, 4.0), 0.1, config.speed, lambda at: ask(lambda: set_speed(at)))
        chosen = gui.add_dropdown("episode", tuple(self._titles), initial_value=next(iter(self._titles)))
        self._run.on_click(lambda _: self.loop.ask(self._toggle))
        chosen.on_update(lambda event: self.loop.ask(lambda: self.play(self._titles[event.target.value])))
        self.recording = self.tape.recordings[0]
        self.play(self.recording)

    def start(self) -> None:
        """Begin to play."""
        self.loop.start()

    def stop(self) -> None:
        """Stop the loop and the page."""
        self.loop.stop()
        self.page.stop()

    def play(self, recording: Recording) -> None:
        """Play an episode from its beginning."""
        self.recording = recording
        self.time_line.max = max(0.02, round(recording.duration_s, 2))
        for trail in self._trails:
            trail.remove()
        self._trails = []
        for index, (view, take) in enumerate(zip(self.views, recording.takes, strict=False)):
            x, y = take.clip.person[:, :2].T
            person = np.column_stack([x, y, np.full(len(x), take.clip.floor_z + TRAIL_HEIGHT_M)])
            self._trail(f"/trail_{index}/tool", take.tool + np.array(view.offset_m), TOOL_RGB)
            if x[0] < FAR_AWAY_M / 2:
                self._trail(f"/trail_{index}/person", person + np.array(view.offset_m), PERSON_RGB)
        for index, view in enumerate(self.views):
            view.set_visible(index < len(recording.takes))
            if len(recording.takes) > 1 and index < len(recording.takes):
                view.name(recording.takes[index].title)
        self.seek(0.0)

    def _trail(self, name: str, points: Array, colour: tuple[int, int, int]) -> None:
        if len(points) > 1:
            lines = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
            self._trails.append(self.page.scene.add_line_segments(name, lines, colors=colour, line_width=2.5))

    def seek(self, time_s: float) -> None:
        """Go to a time of the episode, s."""
        self.position_s, self._piece_s = float(np.clip(time_s, 0.0, self.recording.duration_s)), 0.0
        self._refresh()

    def advance(self) -> float:
        """See `loop.Play`; at its end the episode begins again."""
        self.position_s += self._piece_s
        if self.position_s >= self.recording.duration_s:
            self.position_s = 0.0
        self._piece_s = min(PIECE_S, self.recording.duration_s - self.position_s)
        if time.monotonic() - self._drawn >= SLIDER_S:
            self._refresh()
        return max(self._piece_s, 0.02)

    def make_ready(self) -> None:
        """See `loop.Play`; a replay always is."""

    def show(self, time_s: float) -> None:
        """See `loop.Play`."""
        for view, take in zip(self.views, self.recording.takes, strict=False):
            view.show(take.clip.frame(self.position_s + min(time_s, self._piece_s)))

    def failed(self, error: Exception) -> None:
        """See `loop.Play`."""
        self._status.show(warning(f"{type(error).__name__}: {error}"))

    def _toggle(self) -> None:
        self.loop.set_running(not self.loop.running)
        self._refresh()

    def scrub(self, time_s: float) -> None:
        """Pause at a time of the episode, s."""
        if self.loop.running:
            self.loop.set_running(False)
            self.time_line.value = time_s  # which the play may have moved after the viewer did
        self.seek(time_s)

    def _refresh(self) -> None:
        self._drawn = time.monotonic()
        rows = {
            "run": self.tape.run.name,
            "episode": str(self.recording.episode),
            "time": f"{self.position_s:.1f} s",
            **{str(index + 1): take.title for index, take in enumerate(self.recording.takes)},
        }
        self._status.show(columns([(name, [value]) for name, value in rows.items()], 1))
        self._run.label = "Pause" if self.loop.running else "Run"
        if self.loop.running:  # else the slider leads
            self.time_line.value = round(self.position_s, 2)
