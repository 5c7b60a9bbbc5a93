"""The panel of the page: run, person, comfort level and policy."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import viser

from hrl_comfort import humans
from hrl_comfort.config import CONTROL_STEP_S, ConfigError
from hrl_comfort.config.policies import with_policy
from hrl_comfort.humans.steering import CARRYING
from hrl_comfort.studio.loop import Loop
from hrl_comfort.studio.page import by_viewer
from hrl_comfort.studio.person import motion_config
from hrl_comfort.studio.play import LivePlay, Watcher
from hrl_comfort.studio.session import Session, Step

BY_HAND = "by hand"
MOTIONS = tuple(name for name in humans.MOTIONS if name not in ("live", "recorded"))
"""Motions that can be chosen on the page."""
TOUCH = {"↑ ahead": "w", "↓ back": "s", "← left": "a", "right →": "d", "⟲ turn left": "q", "turn right ⟳": "e"}
HOLD_HZ = 5.0
STATUS_S = 0.2
"""Time between two updates of the status line, s."""
STOPPED_SHARE = 0.005
"""Share of the speed below which the status line calls the arm stopped; it is shown as 0 %."""


class Panel(Watcher):
    """Controls of a live play; every change is asked of the loop."""

    def __init__(self, server: viser.ViserServer, play: LivePlay, loop: Loop) -> None:
        self._server, self._play, self._loop = server, play, loop
        self._outcome, self._message, self._drawn = "", "", 0.0
        gui = server.gui
        self._status = gui.add_markdown("")
        self._add_run(gui)
        with gui.add_folder("Comfort"):
            self._add_comfort(gui)
        with gui.add_folder("Person"):
            self._add_person(gui)
        with gui.add_folder("Policy", expand_by_default=False):
            self._add_policy(gui)
        self.refresh(force=True)

    @property
    def session(self) -> Session:
        """The first cell."""
        return self._play.sessions[0]

    def ask(self, request: Callable[[], None]) -> None:
        """Ask the loop for a change; what was said before is wiped, and the status is shown anew."""

        def done() -> None:
            self._message = ""
            request()
            self.refresh(force=True)

        self._loop.ask(done)

    def _add_run(self, gui: Any) -> None:
        self._run = gui.add_button("Pause")
        once, reset = gui.add_button("One decision"), gui.add_button("Reset")
        speed = gui.add_slider("speed (×)", min=0.1, max=4.0, step=0.1, initial_value=self._loop.speed)
        self._run.on_click(lambda _: self.ask(lambda: self._loop.set_running(not self._loop.running)))
        once.on_click(lambda _: self.ask(self._loop.step))
        reset.on_click(lambda _: self.ask(self._play.reset))
        speed.on_update(lambda event: self.ask(lambda: self._loop.set_speed(event.target.value)))

    def _add_comfort(self, gui: Any) -> None:
        comfort = self.session.config.comfort
        self._level = gui.add_slider(
            "level", min=1, max=comfort.levels, step=1, initial_value=int(self.session.slider.value)
        )
        self._level.on_update(by_viewer(lambda level: self.ask(lambda: self._set_level(float(level)))))
        self._source = gui.add_dropdown("level from", ("slider", comfort.source))
        self._source.on_update(by_viewer(lambda source: self.ask(lambda: self._take_source(source))))
        self._show_source()

    def _show_source(self) -> None:
        source = self.session.config.comfort.source
        self._source.options = ("slider", source)
        self._source.value = "slider" if self.session.by_hand else source
        self._source.visible = source != "fixed"

    def rejoin(self) -> None:
        """Show the options, levels and source of a session that is new."""
        self._level.max = self.session.config.comfort.levels
        self._level.value = int(self.session.slider.value)
        self._option.options = tuple(self.session.options)
        self._show_source()

    def set_level(self, level: float) -> None:
        """Set the level of every cell, and the slider; for requests."""
        self._level.value = round(level)
        self._set_level(level)

    def _set_level(self, level: float) -> None:
        for session in self._play.sessions:
            session.set_level(level)

    def _take_source(self, source: str) -> None:
        for session in self._play.sessions:
            if source == "slider":
                session.set_level(self.session.slider.value)
            else:
                session.follow_source()

    def _add_person(self, gui: Any) -> None:
        person = self._play.person
        names = (BY_HAND, *dict.fromkeys((*MOTIONS, person.human.motion)))
        self._motion = gui.add_dropdown("motion", names, initial_value=person.motion)
        self._motion.on_update(by_viewer(self._take_motion))
        speed = gui.add_slider("walks at most (m/s)", min=0.1, max=3.0, step=0.1, initial_value=person.speed_m_s)
        speed.on_update(lambda event: self.ask(lambda: setattr(person, "speed_m_s", event.target.value)))
        gui.add_markdown("Drag the person, or walk with **W A S D** and turn with **Q E**.")
        self._hands = gui.add_checkbox("hands", False, hint="show a handle at each hand, to drag it")
        self._hands.on_update(by_viewer(lambda held: self.ask(lambda: person.reach(CARRYING.copy() if held else None))))
        with gui.add_folder("Walk by touch", expand_by_default=False):
            for label, key in TOUCH.items():
                gui.add_button(label).on_hold(
                    lambda _, key=key: self._loop.ask(lambda: person.press(frozenset(key))), HOLD_HZ
                )

    def _take_motion(self, name: str) -> None:
        person, human = self._play.person, self.session.config.human
        if name == BY_HAND:
            self.ask(person.take)
        else:
            chosen = human if name == human.motion else motion_config(name)
            self.ask(lambda: person.let_go(chosen))

    def _add_policy(self, gui: Any) -> None:
        self._policies = [
            gui.add_text("policy" if len(self._play.sessions) == 1 else f"policy {index + 1}", policy_label(session))
            for index, session in enumerate(self._play.sessions)
        ]
        swap = gui.add_button("Swap policy", hint="a run folder, a folder of pick, place and return, or expert")
        swap.on_click(lambda _: self.ask(self._swap))
        self._option = gui.add_dropdown("option", tuple(self.session.options), initial_value=self.session.option)
        force = gui.add_button("Force option")
        force.on_click(lambda _: self.ask(lambda: self.session.force(self._option.value)))

    def swap_to(self, source: str) -> None:
        """Let the first cell be played by the policy `source`; for requests.

        Raises:
          ConfigError: it is not there, or does not fit.
        """
        self.session.play(with_policy(self.session.config, source))
        self._policies[0].value = policy_label(self.session)
        self._swapped()

    def _swap(self) -> None:
        for session, text in zip(self._play.sessions, self._policies, strict=True):
            if text.value != policy_label(session):
                session.play(with_policy(session.config, text.value))
        self._swapped()

    def _swapped(self) -> None:
        self._option.options = tuple(self.session.options)
        self._play.reset()

    def began(self, cell: int, session: Session) -> None:
        """See `play.Watcher`."""
        self._outcome = ""

    def stepped(self, cell: int, session: Session, step: Step) -> None:
        """See `play.Watcher`."""
        if step.over:
            self._outcome = step.outcome
        self.refresh(force=step.over)

    def failed(self, error: Exception) -> None:
        """See `play.Watcher`; the page says what is wrong and stays."""
        known = isinstance(error, ConfigError)
        self.say(str(error) if known else f"{type(error).__name__}: {error}")

    def say(self, message: str) -> None:
        """Show a message in the status and as a notification to every viewer."""
        self._message = " ".join(message.split())
        for client in self._server.get_clients().values():
            client.add_notification("Studio", self._message, color="red", auto_close_seconds=10)
        self.refresh(force=True)

    def refresh(self, force: bool = False) -> None:
        """Show the state of the play, at most every STATUS_S unless `force`."""
        now = time.monotonic()
        if not force and now - self._drawn < STATUS_S:
            return
        self._drawn = now
        self._status.content = self._lines()
        label = "Pause" if self._loop.running else "Run"
        if self._run.label != label:
            self._run.label = label
        if self._motion.value != self._play.person.motion:
            self._motion.value = self._play.person.motion
        held = self._play.person.hands is not None
        if self._hands.value != held:
            self._hands.value = held
        if not self.session.by_hand:  # else the slider leads, and must not be set back while it is moved
            self._level.value = round(float(self.session.state.level))

    def _lines(self) -> str:
        session, state = self.session, self.session.state
        running = "running" if self._loop.running else "paused"
        episode, seconds = session.engine.episodes.episode[0] + 1, int(state.steps) * CONTROL_STEP_S
        contacts = sum(each.contacts for each in self._play.sessions)
        lines = [
            f"**{session.option}** · {running} · episode {episode}, {seconds:.1f} s",
            f"level {float(state.level):g} · person {self._play.person.motion} · contacts {contacts}",
        ]
        if session.engine.episodes.drive is not None:
            share, unsafe = float(state.share), sum(each.unsafe_contacts for each in self._play.sessions)
            stopped = " · **the arm is stopped**" if bool(state.braking) or share < STOPPED_SHARE else ""
            lines.append(f"speed passed {share:.0%}{stopped}")
            lines.append(f"protective stops {int(state.protective_stops)} · unsafe contacts {unsafe}")
        if self._loop.running and self._loop.rate < 0.99:
            lines.append(f"slower than real time: {self._loop.rate:.0%}")
        if self._outcome:
            lines.append(f"**{self._outcome}**")
        if self._message:
            lines.append(f"⚠ {self._message}")
        return "  \n".join(lines)


def policy_label(session: Session) -> str:
    """Return the policy of a session as it can be typed; of a chain, the folder of its policies."""
    config = session.config
    if config.policy is not None:
        return config.policy
    folders = {str(path).rsplit("/", 1)[0] for path in config.policies.values()}
    return folders.pop() if len(folders) == 1 else ", ".join(config.policies.values())
