"""`hrl-comfort studio`: a live studio or a replay on a page."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hrl_comfort.comfort.sources import LiveLevels
from hrl_comfort.composition.policies import with_policy
from hrl_comfort.config import ConfigError, StudioConfig
from hrl_comfort.studio.curves import Curves
from hrl_comfort.studio.loop import Loop
from hrl_comfort.studio.page import APART_M, Page, set_camera
from hrl_comfort.studio.panel import Panel, policy_label
from hrl_comfort.studio.person import Person, motion_config
from hrl_comfort.studio.play import LivePlay, Watcher
from hrl_comfort.studio.recorder import RecordControl
from hrl_comfort.studio.replay import ReplayStudio
from hrl_comfort.studio.session import Session, Step
from hrl_comfort.studio.tune.tuning import Tuning
from hrl_comfort.studio.view import CellView
from hrl_comfort.studio.web.page import export_page

CURVES_S = 0.25
"""Simulated time between two updates of the curves, s."""


class LiveStudio(Watcher):
    """A running studio of one or two cells.

    Args:
      config: of the cell, the person, the policies and the page.
    """

    def __init__(self, config: StudioConfig) -> None:
        self.live = LiveLevels()
        """Levels of all cells that follow a live stream."""
        self.sessions = made(cells(config, self.live))
        self.page = Page(config.host, config.port, ", ".join(map(policy_label, self.sessions)))
        self.views = [self._view(index) for index in range(len(self.sessions))]
        by_hand = config.human.motion == "live" and config.human.file is None
        live = config.human if by_hand else motion_config("live")
        self.person = Person(self.sessions, live, config.human)
        self.play = LivePlay(self.sessions, self.views, self.person)
        self.loop = Loop(self.play, config.frames_per_s, config.speed)
        set_camera(self.page, len(self.sessions))
        self.panel = Panel(self.page, self.play, self.loop)
        self.records = RecordControl(self.page, self.play, self.panel, Path(config.output))
        self.curves = Curves(self.page, self.sessions, [str(index + 1) for index in range(len(self.sessions))])
        self.tuning = Tuning(self.page.gui, self.play, self.panel, self.rebuild, Path(config.output))
        self.play.watchers += [self.panel, self.curves, self.records, self]
        self.play.rejoin()
        if config.record:
            self.loop.ask(self.records.toggle)
        self._drawn_s = 0.0
        self.play.reach = lambda hands: self.panel.ask(lambda: self.person.reach(hands))
        self.page.on_keys = lambda keys: self.panel.ask(lambda: self.person.press(keys))

    def start(self) -> None:
        """Begin to play."""
        self.loop.start()

    def _view(self, index: int) -> CellView:
        scene, offset_m = self.sessions[index].engine.scene, (APART_M * index, 0.0, 0.0)
        view = CellView(self.page, scene, f"cell_{index}", offset_m)
        for mesh in view.person:
            mesh.on_drag("left")(Drag(self, view).follow)
        return view

    def rebuild(self, sections: dict[str, Any]) -> None:
        """Make the cells anew with other sections of the configuration; for requests.

        Raises:
          ConfigError: a policy does not fit; the cells stay as they are.
        """
        configs = [replace(session.config, **sections) for session in self.sessions]
        for index, new in enumerate(made(Session(config, self.live.of(config.comfort)) for config in configs)):
            old, self.sessions[index] = self.sessions[index], new
            if old.by_hand and new.by_hand and old.config.comfort.level == new.config.comfort.level:
                new.set_level(old.slider.value)
            old.close()
            self.views[index].remove()
            self.views[index] = self._view(index)
        self.person.rejoin()
        self.curves.rejoin(self.sessions)
        self.panel.rejoin()

    def stop(self) -> None:
        """Stop the loop, a recording, a training, the page and the cells, each even if another fails."""
        with ExitStack() as steps:  # the last first
            steps.callback(self.live.close)
            for session in self.sessions:
                steps.callback(session.close)
            steps.callback(self.page.stop)
            steps.callback(self.tuning.stop)
            steps.enter_context(suppress(ConfigError))  # nothing was recorded yet
            steps.callback(self.records.write)
            steps.callback(self.loop.stop)

    def began(self, cell: int, session: Session) -> None:
        """See `play.Watcher`."""
        self.views[cell].begin_trail()
        if len(self.views) > 1:
            self.views[cell].name(policy_label(session))

    def stepped(self, cell: int, session: Session, step: Step) -> None:
        """See `play.Watcher`; the curves are drawn anew every CURVES_S, for viewers alone."""
        self.views[cell].follow_tool(step.tool)
        self.views[cell].show_zone(session.walk.position[0], session.reach_m)
        if self.curves.time_s - self._drawn_s >= CURVES_S and self.page.get_clients():
            self._drawn_s = self.curves.time_s
            self.curves.draw()


def cells(config: StudioConfig, live: LiveLevels) -> Iterator[Session]:
    """Make the first cell and, if it is asked for, the second.

    Raises:
      ConfigError: a policy does not fit, or a live stream cannot be opened.
    """
    levels = live.of(config.comfort)
    yield Session(config, levels)
    if config.beside is None:
        return
    try:
        second = Session(with_policy(config, config.beside), levels)
    except ConfigError as error:
        raise ConfigError(f"beside={config.beside!r} does not fit the cell: {error}") from None
    yield second


def made(sessions: Iterable[Session]) -> list[Session]:
    """Return `sessions` that are made one by one; if one cannot be made, those before are closed."""
    with ExitStack() as undo:
        found = [undo.enter_context(closing(session)) for session in sessions]
        undo.pop_all()
    return found


class Drag:
    """Drag of the person over the floor: the ray through the pointer meets the height that was grabbed."""

    def __init__(self, studio: LiveStudio, view: CellView) -> None:
        self._studio, self._offset = studio, np.array(view.offset_m)
        self._grabbed = np.zeros(3)

    async def follow(self, event: Any) -> None:
        """Follow a drag; a coroutine, so that its phases stay in order."""
        end = np.array(event.end_position)
        if event.phase == "start":
            self._grabbed = np.array(event.start_position)
            place = np.array([*self._studio.sessions[0].walk.position[0], 0.0]) + self._offset
            self._from_axis = (place - self._grabbed)[:2]
        camera = np.asarray(event.client.camera.position)
        place = on_plane(camera, end, self._grabbed[2])
        if place is not None:
            x, y = (place[:2] + self._from_axis - self._offset[:2]).tolist()
            self._studio.panel.ask(lambda: self._studio.person.drag(x, y))


def on_plane(camera: np.ndarray, through: np.ndarray, height: float) -> np.ndarray | None:
    """Return where the ray from `camera` (3,) through a point (3,) meets z = `height`, m; None if it does not."""
    ray = through - camera
    if abs(ray[2]) < 1e-6:
        return None
    share = (height - camera[2]) / ray[2]
    return camera + share * ray if share > 0 else None


def studio(config: StudioConfig) -> None:
    """Run the studio until it is interrupted or terminated, or write its page."""
    if config.policy is None and not config.policies and config.replay is None:
        raise ConfigError("policy=null: give policy=, policies.* or replay=")
    if config.export is not None:
        export_page(config)
        return
    running, ended = LiveStudio(config) if config.replay is None else ReplayStudio(config), threading.Event()
    with ExitStack() as after:
        for number in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is not signal.SIG_IGN:  # as SIGHUP is under nohup
                after.callback(signal.signal, number, signal.signal(number, lambda *_: ended.set()))
        print(running.page.announcement, flush=True)
        running.start()
        after.callback(running.stop)
        ended.wait()
