"""The folders Parameters and Train of the page."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import viser.uplot

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EnvConfig, StudioConfig, TrainConfig
from hrl_comfort.config.overrides import groups
from hrl_comfort.files.atomic import write_text
from hrl_comfort.studio.curves import COLOURS
from hrl_comfort.studio.panel import PLAIN, Panel
from hrl_comfort.studio.play import LivePlay
from hrl_comfort.studio.text import Text, bold, code, warning
from hrl_comfort.studio.tune.draft import Draft, overlay, overrides_of, training_overrides
from hrl_comfort.studio.tune.forms import Form
from hrl_comfort.studio.tune.training import CURVES, Training

CELL = tuple(field.name for field in fields(EnvConfig))
CONTROLLER = "meta_controller"
LEARNER = tuple(field.name for field in fields(TrainConfig) if field.name in groups("train") and field.name not in CELL)
DRAWN = ("human.spawn", "human.keep_out", "human.held_out")
"""Keys of where a person begins."""
OVERLAY = "overlay.yaml"
POLL_S = 2.0
UNCHANGED = "Nothing has been changed."


class Tuning:
    """Every parameter of the cell by hand, and a training of a policy for it.

    Args:
      gui: of the page.
      play: whose cells are changed; it calls for the change before each episode.
      panel: shows the level, and asks the loop for changes.
      rebuild: makes the cells anew with other sections of the configuration.
      output: folder of trainings and overlays.
    """

    def __init__(
        self, gui: Any, play: LivePlay, panel: Panel, rebuild: Callable[[dict[str, Any]], None], output: Path
    ) -> None:
        self._panel, self._person, self._rebuild, self._output = panel, play.person, rebuild, output
        self._human = panel.session.asked.human
        self.draft = Draft("studio", overrides_of("studio", panel.session.asked))
        self.learner = Draft("train", {"agent": "agent=quick"})
        self.training = Training(self._output)
        self._note = ""
        self._applied: dict[str, str] = {}
        self._tried = self.draft.config
        with gui.add_folder("Parameters", expand_by_default=False):
            self._said = Text(gui, "note", UNCHANGED)
            Form(gui, self.draft, (*CELL, CONTROLLER), self._changed)
        with gui.add_folder("Train", expand_by_default=False):
            self._add_training(gui)
        play.renew = self._renew
        self._over = threading.Event()
        threading.Thread(target=self._show, name="studio training", daemon=True).start()

    def stop(self) -> None:
        """Stop the training."""
        self._over.set()
        self.training.stop()

    def _changed(self, error: ConfigError | None) -> None:
        """Apply what takes effect at once; the rest waits for the next episode."""
        panel, person, config = self._panel, self._person, self.draft.config
        assert isinstance(config, StudioConfig)
        if error is None:
            if config.human != self._human:  # else the person keeps a motion that was chosen for them
                self._human = config.human
                panel.ask(lambda: person.follow(config.human))
            level = config.comfort.level
            if "comfort.level" in self._due and level is not None:
                panel.ask(lambda: panel.set_level(level))
        self._say(error)

    @property
    def _due(self) -> dict[str, str]:
        """Changes that the cells have not been made with, by key."""
        return {key: line for key, line in self.draft.changed.items() if self._applied.get(key) != line}

    def _say(self, error: Exception | None = None) -> None:
        changed = " ".join(self.draft.changed.values())
        said = [code(f"hrl-comfort studio … {changed}")] if changed else [UNCHANGED]
        now = [key for key in self._due if takes_effect_at_once(key)]
        later = [key for key in self._due if key not in now]
        said += [f"In force: {', '.join(now)}"] if now else []
        when = "At the next reset" + " after the recording" * self._panel.recording
        said += [bold(when), ", ".join(later)] if later else []
        said += [warning(error)] if error else []
        self._said.show(*said)

    def _renew(self) -> None:
        """Make the cells as the draft says, once; cells that are recorded or cannot be made so stay as they are."""
        config, error = self.draft.config, None
        assert isinstance(config, StudioConfig)
        if config is self._tried or self._panel.recording:
            return
        self._tried = config
        changed = dict(self.draft.changed)
        controlled = any(key.partition(".")[0] == CONTROLLER for key in self._due)  # a swapped policy has its own
        try:
            self._rebuild({name: getattr(config, name) for name in (*CELL, *([CONTROLLER] * controlled))})
            self._applied = changed
        except ConfigError as refused:
            error = refused
        self._say(error)

    def _add_training(self, gui: Any) -> None:
        self._training_said = Text(gui, "note")
        Form(gui, self.learner, LEARNER, self._say_training)
        sweep = gui.add_text(
            "sweep", "", hint="lists of any keys, as train_seed=0,1,2 agent.gamma=0.98,0.99; one job each"
        )
        for label, act in {
            "Start training": lambda: self.training.start(self._overrides().values(), sweep.value),
            "Stop training": self.training.stop,
            "Resume training": self.training.resume,
            "Watch newest checkpoint": self._watch,
            "Save overlay": self._save,
        }.items():
            gui.add_button(label, color=PLAIN).on_click(lambda _, act=act: self._do(act))
        self._chart = gui.add_uplot(
            data=tuple(np.zeros((CURVES + 1, 1))),
            series=(
                viser.uplot.Series(label="policy steps"),
                *(viser.uplot.Series(label=str(job), stroke=COLOURS[job % len(COLOURS)]) for job in range(CURVES)),
            ),
            legend=viser.uplot.Legend(show=False),
            scales={"x": viser.uplot.Scale(time=False), "y": viser.uplot.Scale(auto=True)},
            title="share of episodes with success",
            height=150,
        )
        self._say_training()

    def _do(self, act: Callable[[], object]) -> None:
        try:
            act()
        except (ConfigError, OSError) as error:
            self._say_training(error)
        else:
            self._say_training()

    def _overrides(self) -> dict[str, str]:
        """Return the overrides of a training, which have been checked.

        Raises:
          ConfigError: the cell is that of a chain, or the learner does not fit it.
        """
        lines = training_overrides(self.draft, self.learner)
        compose("train", lines.values())
        return lines

    def _watch(self) -> None:
        newest = self.training.newest()
        self._panel.ask(lambda: self._panel.swap_to(newest))

    def _save(self) -> None:
        self._output.mkdir(parents=True, exist_ok=True)
        write_text(self._output / OVERLAY, overlay(self._overrides()))
        self._note = f"{self._output / OVERLAY} is written; copied to conf/experiment/ it is a choice of experiment="

    def _say_training(self, error: Exception | None = None) -> None:
        notes = [each for each in (self._note, error and warning(error)) if each]
        self._training_said.show(self.training.status(), *notes)

    def _show(self) -> None:
        """Draw the curve of a training that goes on, until the studio stops."""
        while not self._over.wait(POLL_S):
            if self.training.folder is None:
                continue
            curves = self.training.curves()
            if len(curves[0]):
                self._chart.data = curves
            if self.training.status() not in self._training_said.lines:
                self._say_training()


def takes_effect_at_once(key: str) -> bool:
    """Return whether a change of `key` needs no new cell: how the person moves, and a fixed level."""
    return key == "comfort.level" or (key.split(".")[0] == "human" and not key.startswith(DRAWN))
