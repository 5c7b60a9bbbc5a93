"""The session without a browser: decisions, levels, the person's hand, options and policies."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch

from hrl_comfort.composition.compose import compose
from hrl_comfort.composition.policies import with_policy
from hrl_comfort.config import ConfigError, StudioConfig
from hrl_comfort.humans import body
from hrl_comfort.humans.motions.live import HELD
from hrl_comfort.policies import load
from hrl_comfort.sim.controls import limbs_of
from hrl_comfort.studio.person import HELD_S, Person, motion_config, observed_as
from hrl_comfort.studio.session import Session

SEEN: list[torch.Tensor] = []
LIVE = motion_config("live")


def watching(state):
    """Stand still, and note what each decision sees: level, and the person's x and y."""
    SEEN.append(torch.cat([state.level[:, None], state.humans_seen[:, 0]], dim=-1)[0])
    return torch.zeros_like(state.joint_target)


def studio_config(*overrides: str) -> StudioConfig:
    config = compose("studio", ["task=pick", "policy=expert", "human=still", *overrides])
    assert isinstance(config, StudioConfig)
    return config


@pytest.fixture(scope="module")
def made() -> Iterator[Session]:
    load.SCRIPTED["watching"] = lambda task, scene, config, seed: watching
    session = Session(studio_config("policy=watching"))
    yield session
    session.close()
    del load.SCRIPTED["watching"]


@pytest.fixture
def session(made: Session) -> Session:
    made.keep_person = False
    made.set_motion(made.config.human)
    made.play(replace(made.config, policy="watching"))
    HELD.pose = HELD.hands = None
    SEEN.clear()
    return made


def test_a_step_is_one_decision_whose_pictures_last_as_long(session: Session) -> None:
    step = session.step()
    assert int(step.result.state.steps) == 5 and step.clip.duration_s == pytest.approx(0.1) and not step.over
    first, last = step.clip.frame(-1.0), step.clip.frame(9.0)
    assert np.allclose(first.joints, step.before.joint_pos[0]) and np.allclose(last.joints, session.state.joint_pos[0])
    middle = step.clip.frame(0.05)
    assert np.isfinite(middle.limbs).all() and np.isfinite(middle.props).all(axis=1).sum() == 1


def test_a_source_that_is_followed_again_has_the_person_of_the_episode_that_began_without_it() -> None:
    session = Session(studio_config("policy=random", "comfort.source=fitted"))
    first = session.engine.episodes.draw.person.copy()
    session.set_level(3)
    while (session.engine.episodes.draw.person == first).all():
        session.reset()
    session.follow_source()
    episodes = session.engine.episodes
    assert (episodes.source.person == episodes.draw.person).all()
    assert (episodes.source.draws == episodes.draw.level).all()
    session.close()


def test_the_hand_is_on_the_first_of_two_and_pictures_show_both() -> None:
    session = Session(studio_config("human=pair", "policy=random"))
    person = Person([session], LIVE, session.config.human)
    clip = session.step().clip
    assert clip.people.shape == (6, 2, 23) and clip.frame(0.05).limbs.shape == (14, 7)
    assert np.allclose(clip.people[-1, :, :2], session.state.humans_pos[0])
    second = session.engine.episodes.people.everyone[1]
    start, beside = session.state.humans_pos[0].numpy().copy()
    person.drag(-1.5, -1.5)
    for _ in range(20):
        session.step()
    first, other = session.state.humans_pos[0].numpy()
    assert np.linalg.norm(first - [-1.5, -1.5]) < np.linalg.norm(start - [-1.5, -1.5]) - 0.2
    assert session.engine.episodes.people.everyone[1] is second and np.linalg.norm(other - beside) > 0.01
    session.reset()
    assert np.allclose(session.walk.position[0], first), "who is held stays"
    session.close()


def test_the_level_of_the_slider_is_what_the_next_decision_sees(session: Session) -> None:
    session.set_level(9)
    assert SEEN[-1][0] == 9
    assert float(session.step().result.level) == 9 and SEEN[-1][0] == 9
    session.set_level(99)
    assert SEEN[-1][0] == session.config.comfort.levels


def test_a_drag_is_in_the_observation_of_the_next_decision(session: Session) -> None:
    person = Person([session], LIVE, session.config.human)
    start = session.walk.position[0].copy()
    person.drag(0.0, 0.0)
    session.step()
    moved = SEEN[-1][1:].numpy() - start
    assert np.linalg.norm(moved) == pytest.approx(1.6 * 0.1, abs=1e-6) and moved @ start < 0


def test_the_person_keeps_their_place_when_an_episode_ends_and_walks_on_when_let_go(session: Session) -> None:
    person = Person([session], LIVE, session.config.human)
    person.drag(1.5, 1.5)
    for _ in range(20):
        session.step()
    place = session.walk.position.copy()
    session.reset()
    assert np.allclose(session.walk.position, place) and np.allclose(SEEN[-1][1:], place[0])
    person.drag(0.0, 0.32)  # within the keep-out disc of the base, beside the arm
    for _ in range(20):
        session.step()
    person.let_go()
    before = session.walk.position
    for _ in range(6):
        person.update(0.1)
        session.step()
        assert np.linalg.norm(session.walk.position - before) <= 0.16 + 1e-6  # no jump
        before = session.walk.position
    assert np.linalg.norm(before) >= session.config.human.keep_out_m - 0.02
    assert session.engine.episodes.config.human.motion == "still"


def test_hands_go_where_they_are_held_and_hang_before_the_person_is_let_go(session: Session) -> None:
    person = Person([session], LIVE, session.config.human)
    person.reach(np.array([[0.4, 0.2, 1.2], [0.3, -0.2, 1.1]]))
    assert person.taken and person.hands is not None
    for _ in range(8):
        session.step()
    assert np.allclose(body.hands(session.walk.limbs)[0], person.hands)
    person.let_go()
    for _ in range(12):
        person.update(0.1)
        session.step()
    assert np.isnan(session.walk.limbs).all() and session.engine.episodes.config.human.motion == "still"


def test_a_person_by_hand_is_observed_as_in_the_run(session: Session) -> None:
    clipped = replace(session.config.human, clipping="full")
    session.set_motion(clipped)
    session.reset()
    person = Person([session], LIVE, clipped)
    points = torch.tensor(clipped.spawns_m, dtype=torch.float64)

    def a_spawn_point_is_seen() -> bool:
        session.step()
        return bool((SEEN[-1][1:] == points).all(dim=-1).any()) and not bool(session.state.humans_shown)

    assert a_spawn_point_is_seen()
    person.press(frozenset("d"))
    person.update(0.1)
    assert a_spawn_point_is_seen()
    person.speed_m_s = 0.5
    session.reset()
    assert a_spawn_point_is_seen()
    person.let_go()
    assert a_spawn_point_is_seen()
    person.let_go(observed_as(motion_config("patrol"), clipped))
    assert a_spawn_point_is_seen()
    person.take()
    person.follow(replace(clipped, clipping="off"))  # taken off in the forms
    session.step()
    assert np.allclose(SEEN[-1][1:], session.walk.position[0])


@pytest.mark.parametrize(("safety", "fastest"), [("safety=none", 3.0), ("safety=ssm", 1.6), ("safety=ssm", 1.2)])
def test_nobody_walks_faster_by_hand_than_the_shield_assumes(safety: str, fastest: float) -> None:
    session = Session(studio_config("robot.rating=collaborative", safety, f"safety.human_speed_m_s={fastest}"))
    person = Person([session], LIVE, session.config.human)
    assert person.fastest_m_s == fastest and person.speed_m_s == min(LIVE.speed_m_s, fastest)
    person.speed_m_s = 9.0
    person.drag(2.0, 2.0)
    before = session.walk.position
    session.step()
    assert person.speed_m_s == fastest
    assert np.linalg.norm(session.walk.position - before) == pytest.approx(0.1 * fastest)
    session.close()


def test_the_same_episode_has_the_same_cell_arm_and_walk_at_another_level() -> None:
    session = Session(studio_config("policy=random", "human=random_walk"))

    def played() -> list[np.ndarray]:
        draw = session.engine.episodes.draw
        begins = [np.array(each) for each in (draw.start, draw.arrivals, draw.spawn, session.state.joint_pos)]
        return [*begins, *(session.step().clip.person[-1, :3] for _ in range(3))]

    session.reset()
    first = played()
    session.set_level(9)
    session.repeat()
    assert float(session.state.level) == 9
    for one, two in zip(first, played(), strict=True):
        np.testing.assert_array_equal(one, two)
    session.reset()
    assert any(not np.array_equal(one, two) for one, two in zip(first, played(), strict=True))
    session.close()


def test_whether_a_policy_acts_on_the_level_is_known(session: Session) -> None:
    assert session.observes_level
    session.play(with_policy(session.config, "random"))
    assert not session.observes_level


def test_keys_walk_and_turn_until_they_are_let_go_of_or_fall_silent(session: Session) -> None:
    clock = [0.0]
    person = Person([session], LIVE, session.config.human, clock=lambda: clock[0])
    yaw, start = float(session.walk.yaw[0]), session.walk.position[0].copy()

    def decide(count: int) -> None:
        for _ in range(count):
            person.update(0.1)
            session.step()

    person.press(frozenset("s"))
    decide(2)
    back = session.walk.position[0] - start
    assert back @ [np.cos(yaw), np.sin(yaw)] == pytest.approx(-0.32)
    person.press(frozenset("q"))
    decide(1)
    assert float(session.walk.yaw[0]) == pytest.approx(yaw + 0.15)
    person.press(frozenset("w"))
    clock[0] += HELD_S + 0.1  # the tab is gone
    place = session.walk.position[0].copy()
    decide(2)
    assert np.allclose(session.walk.position[0], place)


def test_a_touch_ends_the_episode_and_is_counted(session: Session) -> None:
    person, contacts = Person([session], LIVE, session.config.human), session.contacts
    person.drag(0.0, 0.0)
    step = next(step for step in iter(session.step, None) if step.over)
    assert step.outcome == "contact with the person" and session.contacts == contacts + 1
    person.drag(1.5, -1.5)
    session.keep_person = False
    assert not session.step().over and int(session.state.steps) == 5  # of the next episode


def test_the_shield_slows_the_arm_beside_a_person_by_hand_and_its_touches_are_not_unsafe() -> None:
    stands = ("human.spawn=points", "human.spawns_m=[[-0.9,-0.9]]", "human.held_out=[]")
    shielded = ("robot.rating=collaborative", "safety=ssm", "task.terminate_on=unsafe_contact")
    session = Session(studio_config(*stands, *shielded))
    person = Person([session], LIVE, session.config.human)
    person.drag(0.0, 0.0)
    shares, reached = [], []
    for _ in range(25):
        session.step()
        shares.append(float(session.state.share))
        reached.append(session.reach_m)
    assert shares[0] == 1.0 and shares[-1] == 0.0 and any(0.1 < share < 0.3 for share in shares)
    assert max(reached) > 0.25 and reached[-1] == 0.0
    assert session.contacts > 0 and session.unsafe_contacts == 0
    session.close()


def test_a_policy_is_swapped_and_a_bad_one_leaves_the_session_as_it_was(session: Session) -> None:
    old = session.executor
    with pytest.raises(ConfigError, match="policy='runs/nowhere' is not there"):
        session.play(with_policy(session.config, "runs/nowhere"))
    assert session.executor is old
    session.play(with_policy(session.config, "expert"))
    session.step()
    assert session.config.policy == "expert" and not SEEN


def test_an_action_that_is_not_finite_is_refused(session: Session) -> None:
    load.SCRIPTED["broken"] = lambda task, scene, config, seed: lambda state: state.joint_target * float("nan")
    with pytest.raises(RuntimeError, match="policy of pick returned an action that is not finite"):
        session.play(replace(session.config, policy="broken"))
    del load.SCRIPTED["broken"]


def test_options_are_forced_where_they_can_start() -> None:
    session = Session(sorting_config())
    assert session.option in ("pick_1", "pick_2")
    other = "pick_2" if session.option == "pick_1" else "pick_1"
    session.force(other)
    session.step()
    assert session.option == other
    with pytest.raises(ConfigError, match="option='place' cannot start now; pick_1, pick_2, wait can"):
        session.force("place")
    session.close()


def sorting_config() -> StudioConfig:
    policies = [f"policies.{name}=random" for name in ("pick", "place", "return")]
    config = compose("studio", ["task=sort", "task.objects=2", "meta_controller=nearest", "human=still", *policies])
    assert isinstance(config, StudioConfig)
    return config


def test_tracker_and_shield_begin_with_the_person_who_is_kept() -> None:
    safe = ("robot.rating=collaborative", "safety=ssm", "safety.bound=worst", "task.terminate_on=unsafe_contact")
    seen = ("randomise.person_rate_hz=[10,10]", "safety.delay_s=0.1")
    session = Session(studio_config(*safe, *seen, "human=random_walk"))
    session.keep_person = True
    session.step()
    session.reset()
    episodes, limbs = session.engine.episodes, limbs_of(session.engine.scene, session.walk)
    assert episodes.plan.tracker.shown == pytest.approx(limbs)
    drive = episodes.drive
    assert drive is not None and drive.shield is not None
    assert drive.shield.memory.seen[:2] == pytest.approx(drive.shield._person.ends(limbs)[:2])
    session.close()
