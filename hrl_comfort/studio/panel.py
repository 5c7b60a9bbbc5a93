"""The panel of the page: what happens, comfort level, run, person and policy."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import viser

from hrl_comfort import humans
from hrl_comfort.composition.policies import with_policy
from hrl_comfort.config import CONTROL_STEP_S, ConfigError
from hrl_comfort.hierarchy.decision import PROBABILITY
from hrl_comfort.humans.steering import CARRYING
from hrl_comfort.studio.loop import Loop
from hrl_comfort.studio.page import add_slider, by_viewer
from hrl_comfort.studio.person import motion_config, observed_as
from hrl_comfort.studio.play import LivePlay, Watcher
from hrl_comfort.studio.session import Session, Step
from hrl_comfort.studio.text import Markup, Text, columns, mark, warning

BY_HAND = "by hand"
MOTIONS = tuple(name for name in humans.MOTIONS if name not in ("live", "recorded"))
"""Motions that can be chosen on the page."""
TOUCH = {"↑ ahead": "w", "↓ back": "s", "← left": "a", "right →": "d", "⟲ turn left": "q", "turn right ⟳": "e"}
HOLD_HZ = 5.0
STATUS_S = 0.2
"""Time between two updates of the readout, s."""
SLOWEST_M_S = 0.1
STOPPED_SHARE = 0.005
"""Share of the speed below which the readout calls the arm stopped; it is shown as 0 %."""
LOWEST, HIGHEST = "keep away, go slowly", "at ease"
"""Meaning of the lowest and the highest comfort level."""
SHOWN_VALUES = 8
"""Options whose values the readout shows: the best, and the one in force."""
NO_LEVEL = "These policies have no comfort level."
HELP = Markup("Drag the person, or walk with <b>W A S D</b> and turn with <b>Q E</b>. Drag elsewhere to look around.")
PLAIN: Any = "gray"
"""Colour of the buttons that page.css draws plain."""


class Panel(Watcher):
    """Controls of a live play; every change is asked of the loop."""

    def __init__(self, server: viser.ViserServer, play: LivePlay, loop: Loop) -> None:
        self._server, self._play, self._loop = server, play, loop
        self._outcomes: dict[int, str] = {}
        """End of the last episode of each cell, in words."""
        self._message, self._drawn = "", 0.0
        self.recording = False
        """Whether the readout has the mark of a recording."""
        gui = server.gui
        self._readout = Text(gui, "readout")
        self._add_comfort(gui)
        self._add_run(gui)
        Text(gui, "help", HELP)
        with gui.add_folder("Person", expand_by_default=False):
            self._add_person(gui)
        with gui.add_folder("Policy", expand_by_default=False):
            self._add_policy(gui)
        self.rejoin()
        self.refresh(force=True)

    @property
    def session(self) -> Session:
        """The first cell."""
        return self._play.sessions[0]

    @property
    def levels(self) -> int | None:
        """Number of comfort levels, None where no policy acts on the level."""
        read = any(session.observes_level for session in self._play.sessions)
        return self.session.config.comfort.levels if read else None

    def ask(self, request: Callable[[], None]) -> None:
        """Ask the loop for a change; what was said before is wiped, and the readout is shown anew."""

        def done() -> None:
            self._message = ""
            request()
            self.refresh(force=True)

        self._loop.ask(done)

    def _add_comfort(self, gui: Any) -> None:
        levels = (1, self.session.config.comfort.levels)
        self._level = add_slider(
            gui, "Comfort level", levels, 1, int(self.session.slider.value), lambda at: self.ask(lambda: self._hold(at))
        )
        self._ends = Text(gui, "ends")
        self._source = gui.add_dropdown("level from", ("slider",))
        self._source.on_update(by_viewer(lambda source: self.ask(lambda: self._take_source(source))))

    def _add_run(self, gui: Any) -> None:
        self._run = gui.add_button("Pause")
        once, reset, self._repeat, self._again, self._free = (
            gui.add_button(label, color=PLAIN, hint=hint)
            for label, hint in (
                ("One decision", None),
                ("Reset", "begin the next episode"),
                ("Same episode again", "the same cell, start of the arm and walk of the person"),
                ("Same at level 10", "the same episode at the other end of the levels"),
                ("Let the person go", None),
            )
        )
        self._run.on_click(lambda _: self.ask(lambda: self._loop.set_running(not self._loop.running)))
        once.on_click(lambda _: self.ask(self._loop.step))
        reset.on_click(lambda _: self.ask(self._play.reset))
        self._repeat.on_click(lambda _: self.ask(self._play.repeat))
        self._again.on_click(lambda _: self.ask(self._repeat_otherwise))
        self._free.on_click(lambda _: self.ask(self._play.person.let_go))
        add_slider(
            gui, "speed (×)", (0.1, 4.0), 0.1, self._loop.speed, lambda at: self.ask(lambda: self._loop.set_speed(at))
        )
        self._shapes = gui.add_checkbox("show collision shapes", False, hint="what the simulation and the shield see")
        self._shapes.on_update(by_viewer(lambda _: self.ask(self._show_shapes)))

    def _show_shapes(self) -> None:
        for view in self._play.views:
            view.show_collision_shapes(self._shapes.value)

    @property
    def _other_level(self) -> int:
        """The end of the levels that is farther from the level in force."""
        levels = self.session.config.comfort.levels
        return levels if float(self.session.state.level) <= (1 + levels) / 2 else 1

    def _repeat_otherwise(self) -> None:
        self.set_level(self._other_level)
        self._play.repeat()

    def rejoin(self) -> None:
        """Show the options, levels, source and limits of sessions or policies that are new."""
        comfort, person = self.session.config.comfort, self._play.person
        source = comfort.source
        self._level.max = comfort.levels
        self._level.value = int(self.session.slider.value)
        self._source.options = ("slider", source)
        for control in (self._level, self._again):
            control.visible = self.levels is not None
        self._source.visible = self.levels is not None and source != "fixed"
        self._ends.show(NO_LEVEL if self.levels is None else ends(self.levels))
        self._speed.max = person.fastest_m_s
        self._speed.value = person.speed_m_s
        self._option.options = tuple(self.session.options)
        self._show_source()
        self._show_shapes()

    def _show_source(self) -> None:
        self._source.value = "slider" if self.session.by_hand else self.session.config.comfort.source

    def set_level(self, level: float) -> None:
        """Set the level of every cell, and the slider; for requests."""
        self._level.value = round(level)
        self._hold(level)

    def _hold(self, level: float) -> None:
        """Set the level of every cell by hand."""
        for session in self._play.sessions:
            session.set_level(level)
        self._show_source()

    def _take_source(self, source: str) -> None:
        for session in self._play.sessions:
            if source == "slider":
                session.set_level(float(self._level.value))
            else:
                session.follow_source()

    def _add_person(self, gui: Any) -> None:
        person = self._play.person
        names = (BY_HAND, *dict.fromkeys((*MOTIONS, person.human.motion)))
        self._motion = gui.add_dropdown("motion", names, initial_value=person.motion)
        self._motion.on_update(by_viewer(self._take_motion))
        self._speed = add_slider(
            gui, "walks at most (m/s)", (SLOWEST_M_S, person.fastest_m_s), 0.1, person.speed_m_s,
            lambda limit: self.ask(lambda: setattr(person, "speed_m_s", limit)),
        )  # fmt: skip
        self._hands = gui.add_checkbox("hands", False, hint="show a handle at each hand, to drag it")
        self._hands.on_update(by_viewer(lambda held: self.ask(lambda: person.reach(CARRYING.copy() if held else None))))
        with gui.add_folder("Walk by touch", expand_by_default=False):
            for label, key in TOUCH.items():
                gui.add_button(label, color=PLAIN).on_hold(
                    lambda _, key=key: self._loop.ask(lambda: person.press(frozenset(key))), HOLD_HZ
                )

    def _take_motion(self, name: str) -> None:
        person, human = self._play.person, self.session.config.human
        if name == BY_HAND:
            self.ask(person.take)
        else:
            chosen = human if name == human.motion else observed_as(motion_config(name), person.human)
            self.ask(lambda: person.let_go(chosen))

    def _add_policy(self, gui: Any) -> None:
        self._policies = [
            gui.add_text("policy" if len(self._play.sessions) == 1 else f"policy {index + 1}", policy_label(session))
            for index, session in enumerate(self._play.sessions)
        ]
        swap = gui.add_button(
            "Swap policy", color=PLAIN, hint="a run folder, a folder of pick, place and return, or expert"
        )
        swap.on_click(lambda _: self.ask(self._swap))
        self._option = gui.add_dropdown("option", tuple(self.session.options), initial_value=self.session.option)
        force = gui.add_button("Force option", color=PLAIN)
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
        self._play.reset()
        self.rejoin()

    def stepped(self, cell: int, session: Session, step: Step) -> None:
        """See `play.Watcher`."""
        if step.over:
            self._outcomes[cell] = step.outcome
        self.refresh(force=step.over)

    def failed(self, error: Exception) -> None:
        """See `play.Watcher`; the page says what is wrong and stays."""
        known = isinstance(error, ConfigError)
        self.say(str(error) if known else f"{type(error).__name__}: {error}")

    def say(self, message: str) -> None:
        """Show a message in the readout and as a notification to every viewer."""
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
        person = self._play.person
        self._readout.show(*self._lines())
        for control, value in ((self._motion, person.motion), (self._hands, person.hands is not None)):
            if control.value != value:
                control.value = value
        for button, label in (
            (self._run, "Pause" if self._loop.running else "Run"),
            (self._again, f"Same at level {self._other_level}"),
        ):
            if button.label != label:
                button.label = label
        if self._free.visible != person.taken:
            self._free.visible = person.taken
        if not self.session.by_hand:  # else the slider leads, and must not be set back while it is moved
            self._level.value = round(float(self.session.state.level))

    def _lines(self) -> list[str]:
        sessions = self._play.sessions
        lines: list[str] = [mark("recording")] if self.recording else []
        rows = readout(sessions, self._play.person.motion)
        if len(sessions) > 1:
            rows.insert(0, ("", [Path(policy_label(each)).name for each in sessions]))
        if self._outcomes:
            rows.append(("last episode", [self._outcomes.get(cell, "") for cell in range(len(sessions))]))
        lines.append(columns(rows, len(sessions)))
        lines += [columns(option_values(each), 1) for each in sessions if each.values]
        if not self._loop.running:
            lines.append("paused")
        elif self._loop.rate < 0.99:
            lines.append(f"slower than real time: {self._loop.rate:.0%}")
        if any(bool(each.state.touching) for each in sessions):
            lines.append(Markup('<span class="studio-contact">contact</span>'))
        lines.append(self._message and warning(self._message))
        return [line for line in lines if line]


def ends(levels: int) -> Markup:
    """Return what the lowest and the highest level mean."""
    return Markup('<div class="ends"><span>1: {}</span><span>{}: {}</span></div>').format(LOWEST, levels, HIGHEST)


def readout(sessions: Sequence[Session], motion: str) -> list[tuple[str, list[str]]]:
    """Return the rows of the readout beside a person of this motion, a value a cell."""
    rows: dict[str, list[str]] = {}
    for session in sessions:
        state, distance = session.state, session.distance_m
        values = {
            "stage": session.stage,
            "distance": "nobody here" if distance is None else f"{distance:.2f} m",
            "person": motion,
            "time": f"{int(state.steps) * CONTROL_STEP_S:.1f} s",
        }
        if session.engine.episodes.drive is not None:
            stopped = bool(state.braking) or float(state.share) < STOPPED_SHARE
            values["speed passed"] = f"{float(state.share):.0%}" + (", stopped" if stopped else "")
            values["protective stops"] = str(int(state.protective_stops))
        values["touches"] = f"{session.contacts}, {session.unsafe_contacts} unsafe"
        values["acts"] = f"policy {session.option}" if len(session.options) > 1 else "one policy"
        values["episodes"] = f"{session.successes} done, {session.failures} failed"
        for name, value in values.items():
            rows.setdefault(name, []).append(value)
    return list(rows.items())


def option_values(session: Session) -> list[tuple[str, list[str]]]:
    """Return rows of the options that could start at the latest choice, best first, with values; ▸ is in force."""
    best = sorted(session.values, key=lambda name: -session.values[name])
    shown = [name for rank, name in enumerate(best) if rank < SHOWN_VALUES or name == session.option]
    form = "{:.0%}" if session.quantity == PROBABILITY else "{:.2f}"
    rows = [("▸ " * (name == session.option) + name, [form.format(session.values[name])]) for name in shown]
    return [("options", [session.quantity]), *rows]


def policy_label(session: Session) -> str:
    """Return the policy of a session as it can be typed; of a chain, the folder of its policies."""
    config = session.config
    if config.policy is not None:
        return config.policy
    folders = {str(path).rsplit("/", 1)[0] for path in config.policies.values()}
    return folders.pop() if len(folders) == 1 else ", ".join(config.policies.values())
