"""The play of two cells beside one person, and the loop that a failing policy does not stop."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np

from hrl_comfort.composition.compose import compose
from hrl_comfort.composition.policies import with_policy
from hrl_comfort.config import StudioConfig
from hrl_comfort.humans.motions.live import HELD
from hrl_comfort.plots.clip import Frame
from hrl_comfort.studio.loop import Loop
from hrl_comfort.studio.person import Person, motion_config
from hrl_comfort.studio.play import HOLD_S, LivePlay
from hrl_comfort.studio.session import Session


class View:
    """A view that remembers the latest picture."""

    frame: Frame
    red = False

    def show(self, frame: Frame) -> None:
        self.frame = frame

    def flash(self, contact: bool) -> None:
        self.red = contact

    def show_hands(self, hands: object, moved: object) -> None:
        pass


def test_two_policies_meet_the_same_person_and_begin_together() -> None:
    HELD.pose = None
    config = compose("studio", ["task=pick", "policy=expert", "human=random_walk"])
    assert isinstance(config, StudioConfig)
    sessions = [Session(config), Session(with_policy(replace(config), "random"))]
    views = [View(), View()]
    play = LivePlay(sessions, views, Person(sessions, motion_config("live"), config.human))
    ended: list[float] = []
    while not ended or not all(session.over for session in sessions):
        one, two = (session.state for session in sessions)
        if int(one.steps) == int(two.steps):
            assert np.allclose(one.humans_pos, two.humans_pos)
        if sessions[0].over or sessions[1].over:
            ended.append(play.now_s)
        lasts = play.advance()
        assert 0 < lasts <= 0.1 + 1e-9
        play.show(lasts)
    assert np.allclose(views[0].frame.limbs, play._clips[0].frame(9.0).limbs)
    assert play.advance() == HOLD_S
    play.advance()
    assert [int(session.engine.episodes.episode[0]) for session in sessions] == [1, 1]
    assert not any(session.over for session in sessions) and not any(view.red for view in views)
    for session in sessions:
        session.close()


def test_an_arm_never_begins_inside_a_person_who_keeps_their_place() -> None:
    HELD.pose = None
    config = compose("studio", ["task=pick", "policy=expert", "human=still"])
    assert isinstance(config, StudioConfig)
    session = Session(config)
    person = Person([session], motion_config("live"), config.human)
    play = LivePlay([session], [View()], person)
    begins: list[int] = []
    while len(begins) < 4:
        person.drag(-0.05, -0.1)  # into the base; the episode ends with a contact
        play.advance()
        assert not any(warning.number for data in session.engine.physics._data for warning in data.warning)
        if int(session.state.steps) == 0:
            begins.append(session.decisions)
            place = session.walk.position.copy()
            play.advance()
            assert np.allclose(session.walk.position, place)
            assert not bool(session.state.touching)
    session.close()


class Failing:
    """A play whose third decision fails."""

    def __init__(self) -> None:
        self.decisions = 0
        self.errors: list[Exception] = []
        self.changed = threading.Event()

    def advance(self) -> float:
        self.decisions += 1
        if self.decisions == 3:
            raise RuntimeError("this policy is broken")
        return 0.01

    def make_ready(self) -> None:
        pass

    def show(self, time_s: float) -> None:
        pass

    def failed(self, error: Exception) -> None:
        self.errors.append(error)
        self.changed.set()


def test_a_failing_policy_pauses_the_loop_which_then_goes_on_when_asked() -> None:
    play = Failing()
    loop = Loop(play, frames_per_s=50.0, speed=4.0)
    loop.start()
    assert play.changed.wait(30) and not loop.running and play.decisions == 3
    asked = threading.Event()
    loop.ask(lambda: loop.set_speed(2.0))
    loop.ask(loop.step)
    loop.ask(asked.set)
    assert asked.wait(30) and play.decisions == 4 and not loop.running and len(play.errors) == 1
    loop.stop()
