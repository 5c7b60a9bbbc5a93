"""Tapes: the recorded episodes of an evaluation, failures first, each at all of its levels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pandas import DataFrame

from hrl_comfort.analysis.episodes import terminations
from hrl_comfort.config import CellConfig, ConfigError, RobotConfig
from hrl_comfort.config.checks import section
from hrl_comfort.files.run_folder import Recorded, Run, recorded
from hrl_comfort.files.tables import column
from hrl_comfort.plots.clip import Array, Clip, path_clip
from hrl_comfort.scene.workcell import build_scene


@dataclass(frozen=True)
class Recording:
    """An episode at each of its recorded levels."""

    episode: int
    takes: list[Take]

    @property
    def title(self) -> str:
        """Episode, and how its takes ended."""
        return f"episode {self.episode}: {', '.join(take.title for take in self.takes)}"

    @property
    def success(self) -> bool:
        """Whether all takes succeeded."""
        return all(take.success for take in self.takes)

    @property
    def ends(self) -> list[Take]:
        """The takes of the lowest and the highest level, or the only one."""
        return list(dict.fromkeys((self.takes[0], self.takes[-1])))

    @property
    def duration_s(self) -> float:
        """Duration of the longest take, s."""
        return max(take.clip.duration_s for take in self.takes)


class Tape:
    """The recorded episodes of an evaluation.

    Args:
      run: evaluation with paths.csv and config.yaml.

    Raises:
      ConfigError: it has no recorded path, or no configuration of a cell.
    """

    def __init__(self, run: Run) -> None:
        self.run = run
        takes = recorded(run)
        if not takes:
            raise ConfigError(f"{str(run.folder)!r} has no paths.csv; evaluate with record=true")
        if not {"robot", "cell", "task"} <= run.config.keys():
            raise ConfigError(f"{str(run.folder)!r} has no config.yaml, which says what robot and cell it was")
        try:
            self.robot, self.cell = section(RobotConfig, run.config["robot"]), section(CellConfig, run.config["cell"])
        except ConfigError as error:
            raise ConfigError(f"{str(run.folder)!r} has another config.yaml: {error}") from None
        self.scene = build_scene(self.robot, self.cell, substeps=2)
        found: dict[int, list[Take]] = {}
        for each in takes:
            found.setdefault(each.episode, []).append(Take(**vars(each), tape=self))
        recordings = [Recording(*each) for each in found.items()]
        self.recordings = sorted(recordings, key=lambda each: each.success)
        """Episodes, those with a failure first."""
        self.cells = max(len(each.takes) for each in recordings)
        """Most levels at which an episode was recorded."""

    @property
    def knows_objects(self) -> bool:
        """Whether the objects lie where the cell says."""
        task = self.run.config["task"]
        still = task.get("objects", 1) == 1 and task.get("object_jitter_m", 0.0) == 0
        return bool(still and not self.robot.gripper.holds)


@dataclass(frozen=True, eq=False)
class Take(Recorded):
    """One recording of an episode, at one level, on its tape."""

    tape: Tape

    @property
    def ended(self) -> str:
        """Its ending in words."""
        return str(terminations(DataFrame([self.row])).iloc[0]) if self.row else "not in episodes.csv"

    @property
    def title(self) -> str:
        """Level and how it ended."""
        return self.ended if self.level is None else f"level {self.level} {self.ended}"

    @property
    def success(self) -> bool:
        """Whether the episode succeeded."""
        return bool(self.row.get("success", False))

    @property
    def tool(self) -> Array:
        """(T, 3) m, tool centre point."""
        return np.column_stack([column(self.path, f"tcp_{axis}") for axis in "xyz"])

    @property
    def task(self) -> str:
        """Name of the task."""
        return str(self.row.get("task") or self.tape.run.config["task"]["name"])

    @property
    def kind(self) -> str:
        """Kind of the first object; the cell's first where the episode's is not known."""
        kinds, named = self.tape.cell.kinds, str(self.row.get("object"))
        return named if named in kinds else kinds[0]

    @cached_property
    def clip(self) -> Clip:
        """Its pictures."""
        tape = self.tape
        return path_clip(self.path, tape.scene, self.task, self.kind if tape.knows_objects else None)
