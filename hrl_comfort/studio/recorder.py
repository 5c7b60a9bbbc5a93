"""Recordings: what one sees, as an evaluation folder with the person's motion and a video, and their button."""

from __future__ import annotations

import threading
from collections.abc import Container
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
import viser
from pandas import DataFrame

from hrl_comfort.config import CONTROL_STEP_S, ConfigError
from hrl_comfort.evaluation.rollout import EpisodeRecorder, Result, path_columns, rounded
from hrl_comfort.files.atomic import all_or_none
from hrl_comfort.files.output import output_folder
from hrl_comfort.files.run_folder import read_run
from hrl_comfort.files.tables import write_table
from hrl_comfort.humans import drawn_set
from hrl_comfort.humans.recordings import HEADER
from hrl_comfort.plots.tape import Tape
from hrl_comfort.plots.video import frames, write_video
from hrl_comfort.scene.camera import PicturesUnavailableError
from hrl_comfort.studio.panel import Panel
from hrl_comfort.studio.play import LivePlay, Watcher
from hrl_comfort.studio.session import ROW, Session, Step
from hrl_comfort.studio.text import Text, code

SPLIT = "live"
"""Value of the column `split` of a recorded episode."""
LIVE = "live"
"""Value of the column `human` of an episode in which the person was driven by hand."""


class Recorder:
    """Recorder of one session; it writes in a folder of its own.

    Args:
      session: what is recorded, from the beginning of an episode on.
      output: folder under which `recording_1`, `recording_2`, … are made.
      taken: folders that other recorders are going to make.
    """

    def __init__(self, session: Session, output: Path, taken: Container[Path] = ()) -> None:
        self._session = session
        number = 1
        while (output / f"recording_{number}").exists() or output / f"recording_{number}" in taken:
            number += 1
        self.folder = output / f"recording_{number}"
        self._result = Result([], [], [])
        self._recorder: EpisodeRecorder | None = None
        self.begin()

    @property
    def episodes(self) -> int:
        """Number of episodes that have ended."""
        return len(self._result.episodes)

    def begin(self) -> None:
        """Begin with the first state of an episode; one that has not ended is dropped."""
        session = self._session
        entries = drawn_set("validation", session.config.first_seed, 1)
        entries = replace(entries, episode=np.array([self.episodes]))
        config = replace(session.config, record=True)
        self._recorder = EpisodeRecorder(config, None, session.engine, entries, self._result)
        self._recorder.begin(session.state)
        self._levels: set[float] = set()
        self._by_hand = False

    def add(self, step: Step) -> None:
        """Add a decision of the session."""
        if self._recorder is None:
            return
        self._levels.add(float(step.result.level))
        self._by_hand |= self._session.engine.episodes.human.motion == LIVE
        self._recorder.add(step.result, ROW, torch.tensor([step.over]), step.runs)
        self._last = step
        if step.over:
            self._finish()

    def stop(self) -> Path:
        """Write the folder, the episode under way as one that was cut short; return it.

        Raises:
          ConfigError: no decision was recorded, or the folder is taken by now.
        """
        if self._recorder is not None and self._levels:
            self._recorder.cut(self._last.result)
            self._finish()
        if not self.episodes:
            raise ConfigError("nothing was recorded: let it run for a decision before you stop")
        with output_folder(self.folder, type(None)), all_or_none():
            self._result.write(self.folder, self._session.config)
            table = DataFrame(self._result.paths, columns=path_columns(len(self._result.paths[0])))
            table["t"] = (table["step"] * CONTROL_STEP_S).map(rounded)
            for episode, rows in table.groupby("episode"):
                lines = rows[["t", "human_x", "human_y", "human_yaw"]].to_numpy().tolist()
                write_table(self.folder / f"human_{episode}.csv", HEADER, lines)
        return self.folder

    def draw(self) -> Path:
        """Draw the last episode to video.mp4 and return its path; to be called after `stop`, in any thread.

        Raises:
          PicturesUnavailableError: there is no off-screen OpenGL.
        """
        last = max(Tape(read_run(self.folder)).recordings, key=lambda each: each.episode)
        return write_video(self.folder / "video.mp4", frames(last.takes[0]))

    def _finish(self) -> None:
        assert self._recorder is not None
        first = len(self._result.options)
        self._recorder.finish()
        self._recorder = None
        row = replace(self._result.episodes[-1], split=SPLIT, episode_seed=None)  # no seed of a split draws it
        if self._by_hand:
            row = replace(row, human=LIVE)
        if len(self._levels) > 1:
            row = replace(row, comfort_level=None)
            for line in self._result.options[first:]:
                line["comfort_level"] = None
        self._result.episodes[-1] = row


class RecordControl(Watcher):
    """Button that records every cell, from the beginning of an episode to the next press.

    Args:
      server: of the page.
      play: whose sessions are recorded.
      panel: shows the mark of a recording.
      output: folder of the recordings.
    """

    def __init__(self, server: viser.ViserServer, play: LivePlay, panel: Panel, output: Path) -> None:
        self._play, self._panel, self._output = play, panel, output
        self.recorders: list[Recorder] = []
        """One a cell while it records, else none."""
        self.folders: list[Path] = []
        """Folders of the latest recording."""
        with server.gui.add_folder("Record", expand_by_default=False):
            self._button = server.gui.add_button("Record", color="red", hint=f"writes an evaluation under {output}")
            self._text = Text(server.gui, "note")
        self._button.on_click(lambda _: panel.ask(self.toggle))

    def toggle(self) -> None:
        """Begin a recording with a new episode, or end it and write its folders; for requests.

        Raises:
          ConfigError: nothing was recorded.
        """
        if not self.recorders:
            self._play.reset()
            self.recorders = []
            for session in self._play.sessions:
                self.recorders.append(Recorder(session, self._output, {each.folder for each in self.recorders}))
            self._mark(True)
            return
        recorders = self.recorders
        self.write()
        self._tell("")
        threading.Thread(target=self._draw, args=(recorders,), name="studio video", daemon=True).start()

    def write(self) -> None:
        """End the recording, if there is one, and write its folders without a video.

        Raises:
          ConfigError: nothing was recorded.
        """
        recorders, self.recorders = self.recorders, []
        self._mark(False)
        if recorders:
            self.folders = [recorder.stop() for recorder in recorders]

    def began(self, cell: int, session: Session) -> None:
        """See `play.Watcher`."""
        if self.recorders:
            self.recorders[cell].begin()

    def stepped(self, cell: int, session: Session, step: Step) -> None:
        """See `play.Watcher`."""
        if self.recorders:
            self.recorders[cell].add(step)

    def _draw(self, recorders: list[Recorder]) -> None:
        try:
            for recorder in recorders:
                recorder.draw()
        except PicturesUnavailableError as error:
            self._tell(str(error))
            return
        self._tell("with video.mp4")

    def _tell(self, more: str) -> None:
        lines = [*map(code, self.folders), *([more] if more else [])]
        self._text.show(*lines, code(f"hrl-comfort report {self.folders[0]}"))

    def _mark(self, recording: bool) -> None:
        self._panel.recording = recording
        self._button.label = "Stop recording" if recording else "Record"
        self._text.show()
