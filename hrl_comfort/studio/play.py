"""The live play: sessions beside one person, their views and their panel, advanced by the real-time loop."""

from __future__ import annotations

from collections.abc import Callable

from hrl_comfort.humans.walk import Array
from hrl_comfort.plots.clip import Clip
from hrl_comfort.studio.person import Person
from hrl_comfort.studio.session import Session, Step
from hrl_comfort.studio.view import CellView

HOLD_S = 1.0
"""Simulated time for which the end of an episode is shown."""


class Watcher:
    """A part of the page that follows the play, as far as it overrides these methods."""

    def began(self, cell: int, session: Session) -> None:
        """Follow the first state of an episode in the cell of this index."""

    def stepped(self, cell: int, session: Session, step: Step) -> None:
        """Follow a decision in the cell of this index."""

    def failed(self, error: Exception) -> None:
        """Say that a decision, a picture or a request failed."""


class LivePlay:
    """Sessions side by side, each at its own decisions; a new episode begins once all of them are over."""

    def __init__(self, sessions: list[Session], views: list[CellView], person: Person) -> None:
        self.sessions, self.views, self.person = sessions, views, person
        self.renew: Callable[[], None] = lambda: None
        """Called before each episode; it may replace sessions and views."""
        self.watchers: list[Watcher] = []
        self.reach: Callable[[Array], None] = person.reach
        """Called with the hands (2, 3) m, in the person's frame, that a viewer drags."""
        self.hold_s = HOLD_S
        """Simulated time for which the end of an episode is shown."""
        self.now_s = 0.0
        """Simulated time at which the latest decision began."""
        self._start = [0.0] * len(sessions)
        self._clips: list[Clip] = [session.still() for session in sessions]
        self._hold = False

    def advance(self) -> float:
        """See `loop.Play`."""
        ends = [begun + clip.duration_s for begun, clip in zip(self._start, self._clips, strict=True)]
        going = [index for index, session in enumerate(self.sessions) if not session.over]
        if not going:
            return self._end(max(ends))
        self.now_s = min(ends[index] for index in going)
        self.person.update(self.sessions[0].decision_s)
        for index in going:
            if ends[index] <= self.now_s + 1e-9:
                step = self.sessions[index].step()
                self._start[index], self._clips[index] = self.now_s, step.clip
                self.views[index].flash(bool(step.result.state.touching))
                for watcher in self.watchers:
                    watcher.stepped(index, self.sessions[index], step)
        return min(self._start[index] + self._clips[index].duration_s for index in going) - self.now_s

    def make_ready(self) -> None:
        """See `loop.Play`."""
        if all(session.over for session in self.sessions):
            self.reset()

    def show(self, time_s: float) -> None:
        """See `loop.Play`."""
        for start, clip, view in zip(self._start, self._clips, self.views, strict=True):
            view.show(clip.frame(self.now_s + time_s - start))
        self.views[0].show_hands(self.person.hands, self.reach)

    def failed(self, error: Exception) -> None:
        """See `loop.Play`."""
        for watcher in self.watchers:
            watcher.failed(error)

    def reset(self) -> None:
        """Begin the next episode in every cell."""
        self.renew()
        for session in self.sessions:
            session.reset()
        self.person.stay()
        self.rejoin()

    def repeat(self) -> None:
        """Begin the same episode again in every cell; changes of the cell wait for the next one."""
        for session in self.sessions:
            session.repeat()
        self.person.stay()
        self.rejoin()

    def rejoin(self) -> None:
        """Show the states of the sessions, in which an episode has just begun."""
        self._hold = False
        self._start = [self.now_s] * len(self.sessions)
        self._clips = [session.still() for session in self.sessions]
        for index, (session, view) in enumerate(zip(self.sessions, self.views, strict=True)):
            view.flash(False)
            for watcher in self.watchers:
                watcher.began(index, session)

    def _end(self, ended_s: float) -> float:
        """Hold the last picture of an episode once, then begin the next."""
        self.now_s = ended_s
        self._hold = not self._hold
        if self._hold:
            self._clips = [session.still() for session in self.sessions]
            self._start = [ended_s] * len(self.sessions)
            return self.hold_s
        self.now_s += self.hold_s
        self.reset()
        return 0.0
