"""People move within their bounds, by their motion, gait or recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hrl_comfort import humans
from hrl_comfort.config import CONTROL_STEP_S, FAR_AWAY_M, ConfigError, HumanConfig
from hrl_comfort.humans import body
from tests.humans.around import STATIONS, around
from tests.humans.paper import GOALS, HUMAN, SPAWNS, discs, human, no_discs

PAPER = ("still", "random_walk", "arc", "approach", "patrol")
"""Motions that jump: they stay within `bound_m` of the spawn and are cut at keep-out discs."""


def stroll(config: HumanConfig, spawn: np.ndarray, steps: int, tcp=(0.3, 0.2), keep_out=None) -> list[humans.Walk]:
    """Return the initial walk and those after each of `steps` control steps."""
    rng, n = np.random.default_rng(1), len(spawn)
    walks = [humans.begin(config, spawn)]
    for _ in range(steps):
        noise = rng.random((n, humans.NOISE))
        walks.append(humans.advance(config, walks[-1], noise, around(np.tile(tcp, (n, 1)), keep_out or discs(n))))
    return walks


def free_spawns(rows: int) -> np.ndarray:
    spawns = humans.moved_spawns(HUMAN, GOALS)[np.arange(rows) % len(SPAWNS)]
    drawn = humans.jittered_spawn(HUMAN, spawns, np.random.default_rng(2).random((rows, 2)))
    return humans.outside(drawn, discs(rows))


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.abs((a - b + np.pi) % (2 * np.pi) - np.pi)


def test_an_unknown_motion_is_refused_with_the_list_of_motions() -> None:
    with pytest.raises(ConfigError, match=r"human\.motion='dance'.*random_walk.*recorded"):
        humans.begin(human("dance"), np.zeros((1, 2)))
    assert set(humans.MOTIONS) == {*PAPER, "none", "worker", "reactive", "fetcher", "adversary", "recorded", "live"}


@pytest.mark.parametrize("motion", PAPER)
def test_humans_stay_near_their_spawn_and_out_of_the_discs_and_never_jump(motion: str) -> None:
    walks = stroll(human(motion), free_spawns(200), 500)
    position = np.stack([w.position for w in walks])
    to_discs = np.linalg.norm(position[:, :, None] - discs(200).centres, axis=-1)
    assert to_discs.min() >= HUMAN.keep_out_m
    assert np.linalg.norm(position - walks[0].spawn, axis=-1).max() <= HUMAN.bound_m + 1e-9
    # Twice the longest proposed step: jitter on both axes, or that and the turn of an arc.
    assert np.linalg.norm(np.diff(position, axis=0), axis=-1).max() < 0.05


@pytest.mark.parametrize("motion", PAPER)
def test_rows_do_not_influence_each_other(motion: str) -> None:
    spawns, noise = free_spawns(19), np.random.default_rng(3).random((60, 19, humans.NOISE))
    tcp = np.random.default_rng(4).uniform(-0.4, 0.4, (19, 2))
    together, alone = humans.begin(human(motion), spawns), humans.begin(human(motion), spawns[7:8])
    for step in noise:
        together = humans.advance(human(motion), together, step, around(tcp, discs(19)))
        alone = humans.advance(human(motion), alone, step[7:8], around(tcp[7:8], discs(1)))
    for name, value in vars(together.rows(np.array([7]))).items():
        np.testing.assert_array_equal(value, getattr(alone, name), err_msg=name)


def test_patrol_stays_at_every_station_for_its_time_and_faces_the_robot_there() -> None:
    config = human("patrol", bound_m=5.0, stay_s=2.0)
    walks = stroll(config, free_spawns(30), 4000)
    stations = np.array(STATIONS)
    position, yaw = (np.stack([getattr(walk, name) for walk in walks]) for name in ("position", "yaw"))
    still = (np.diff(position, axis=0) == 0).all(axis=-1)
    at = np.linalg.norm(position[:, :, None] - stations, axis=-1) < 1e-9
    assert at.any(axis=0).all()  # everyone visits every station
    assert not still[0].any()  # and walks at once from the spawn
    working = still[1000:] & at[1000:-1].any(axis=-1)
    stays = working.sum() / (np.diff(working.astype(int), axis=0) == -1).sum() * CONTROL_STEP_S
    assert 1.7 < stays < 2.3
    facing = humans.facing_base(position.reshape(-1, 2)).reshape(yaw.shape)
    assert angle_between(yaw[1001:], facing[1001:])[at[1001:].any(axis=-1)].max() < 1e-9
    moved = np.linalg.norm(np.diff(position, axis=0), axis=-1) / CONTROL_STEP_S
    assert 0.45 < moved[moved > 0].mean() < 0.55


def test_advance_leaves_its_arguments_alone() -> None:
    walk = humans.begin(HUMAN, free_spawns(5))
    before = {name: value.copy() for name, value in vars(walk).items()}
    humans.advance(HUMAN, walk, np.full((5, 3), 0.9), around(np.zeros((5, 2)), discs(5)))
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(walk, name), value, err_msg=name)


def test_motion_none_stays_far_away() -> None:
    for walk in stroll(human("none"), free_spawns(3), 5):
        np.testing.assert_array_equal(walk.position, [[FAR_AWAY_M, 0.0]] * 3)


def test_a_still_human_faces_the_robot_and_does_not_move_a_limb() -> None:
    spawn = np.array([[0.0, 1.0], [-1.0, 0.0]])
    walk = stroll(human("still"), spawn, 10)[-1]
    np.testing.assert_array_equal(walk.position, spawn)
    np.testing.assert_allclose(angle_between(walk.yaw, np.array([-np.pi / 2, 0.0])), 0.0, atol=1e-12)
    np.testing.assert_array_equal(humans.gait(walk)[1], 0.0)


def test_the_random_walk_jitters_within_its_bounds_or_steps_forward() -> None:
    spawn = np.tile([0.0, 1.5], (3, 1))
    noise = np.array([[0.0, 0.75, 0.5], [0.5, 0.5, 0.02], [0.0, 0.0, 0.0199]])
    walk = humans.advance(HUMAN, humans.begin(HUMAN, spawn), noise, around(np.zeros((3, 2)), no_discs(3)))
    np.testing.assert_allclose(walk.position - spawn, [[-0.015, 0.0075], [0.0, 0.0], [0.0, -0.008]], atol=1e-15)
    np.testing.assert_allclose(walk.yaw, np.arctan2(-walk.position[:, 1], -walk.position[:, 0]))


def test_the_arc_swings_through_its_angle_and_back_and_only_the_radius_wanders() -> None:
    config = human("arc", bound_m=10.0, arc_steps=50)
    walks = stroll(config, np.array([[1.5, 0.0]]), 100, keep_out=no_discs(1))
    position = np.concatenate([w.position for w in walks])
    bearing, radius = np.degrees(np.arctan2(position[:, 1], position[:, 0])), np.linalg.norm(position, axis=1)
    np.testing.assert_allclose(bearing[:51], np.linspace(0.0, 30.0, 51), atol=1e-9)
    np.testing.assert_allclose(bearing[50:], np.linspace(30.0, 0.0, 51), atol=1e-9)
    assert 0.0 < np.abs(np.diff(radius)).max() <= 0.03
    yaw = np.array([w.yaw[0] for w in walks])
    np.testing.assert_allclose(angle_between(yaw, np.radians(bearing) + np.pi), 0.0, atol=1e-9)


def test_the_approaching_human_walks_straight_at_the_tool_and_stops_there() -> None:
    config = human("approach", bound_m=10.0)
    walks = stroll(config, np.array([[1.2, 0.2]]), 150, tcp=(0.3, 0.2), keep_out=no_discs(1))
    x = np.array([w.position[0] for w in walks])
    np.testing.assert_allclose(x[:80], np.stack([1.2 - 0.01 * np.arange(80), np.full(80, 0.2)], axis=1), atol=1e-9)
    np.testing.assert_allclose(np.abs([w.yaw[0] for w in walks[1:80]]), np.pi, atol=1e-9)
    assert np.linalg.norm(x[-1] - [0.3, 0.2]) <= 0.01


def test_a_human_who_walks_into_a_disc_slides_round_its_edge() -> None:
    keep_out = humans.KeepOut(np.zeros((1, 1, 2)), 0.35)
    walks = stroll(human("approach", bound_m=10.0), np.array([[1.0, 0.1]]), 300, (-0.8, 0.0), keep_out)
    x = np.concatenate([w.position for w in walks])
    assert np.linalg.norm(x, axis=1).min() >= 0.35
    assert x[-1, 0] < -0.35, "it comes out on the other side"


def test_the_gait_goes_with_the_ground_covered_and_swings_at_most_25_degrees() -> None:
    walks = stroll(human("approach", bound_m=10.0, speed_m_s=2.0), np.array([[9.0, 0.0]]), 200, (0, 0), no_discs(1))
    phase, swing = humans.gait(walks[-1])
    np.testing.assert_allclose(np.degrees(swing), 25.0)
    assert walks[-1].walked_m[0] == pytest.approx(200 * 0.04, rel=0.02)
    assert phase[0] == pytest.approx(2 * np.pi * walks[-1].walked_m[0] / 1.4)
    slow = stroll(human("approach", bound_m=10.0), np.array([[9.0, 0.0]]), 300, (0, 0), no_discs(1))[-1]
    assert np.degrees(humans.gait(slow)[1][0]) == pytest.approx(12.5, rel=0.01)


def test_put_changes_the_given_rows_only() -> None:
    old = stroll(HUMAN, free_spawns(4), 30)[-1]
    mixed = old.put(np.array([2]), humans.begin(HUMAN, np.array([[0.9, 0.9]])))
    assert mixed.step.tolist() == [30, 30, 0, 30]
    np.testing.assert_array_equal(mixed.position[2], [0.9, 0.9])
    np.testing.assert_array_equal(mixed.rows(np.array([0, 1, 3])).position, old.position[[0, 1, 3]])
    assert old.step.tolist() == [30] * 4


# ---- recorded --------------------------------------------------------------------------------------------


def test_recorded_interpolates_the_shorter_turn_and_holds_its_end(tmp_path: Path) -> None:
    file = tmp_path / "motion.csv"
    file.write_text("t,x,y,yaw\n0,1,0,3.1\n0.04,2,0,-3.1\n0.08,2,4,-3.1\n")
    walks = stroll(human("recorded", file=str(file)), np.array([[0.0, 0.0]]), 6)
    expected = [[1, 0], [1.5, 0], [2, 0], [2, 2], [2, 4], [2, 4], [2, 4]]
    np.testing.assert_allclose(np.concatenate([w.position for w in walks]), expected, atol=1e-12)
    assert angle_between(walks[1].yaw, np.array([np.pi])) < 1e-9
    assert angle_between(walks[-1].yaw, np.array([-3.1])) < 1e-9


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "t,x,y,yaw"),
        ("time,x,y,yaw\n0,0,0,0\n", "line 1.*t,x,y,yaw"),
        ("t,x,y,yaw\n", "no line"),
        ("t,x,y,yaw\n0,0,0,0\n1,nan,0,0\n", "line 3.*finite"),
        ("t,x,y,yaw\n0,0,0\n", "line 2.*four"),
        ("t,x,y,yaw\n0,0,zero,0\n", "line 2.*zero"),
        ("t,x,y,yaw\n0,0,0,0\n1,0,0,0\n1,0,0,0\n", "line 4"),
        ("t,x,y,yaw\n0,1e300,0,0\n", "line 2 has a value beyond"),
    ],
)
def test_a_bad_motion_file_is_refused_and_its_line_named(tmp_path: Path, text: str, says: str) -> None:
    file = tmp_path / "bad.csv"
    file.write_text(text)
    with pytest.raises(ConfigError, match=says):
        humans.begin(human("recorded", file=str(file)), np.zeros((1, 2)))


def test_a_motion_file_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    file = tmp_path / "motion.csv"
    file.write_text("t,x,y,yaw\n0,1,2,0\n", encoding="utf-8-sig")
    walk = humans.begin(human("recorded", file=str(file)), np.zeros((1, 2)))
    assert walk.position.tolist() == [[1.0, 2.0]]


def test_a_missing_motion_file_is_named() -> None:
    with pytest.raises(ConfigError, match=r"human\.file='nowhere\.csv'"):
        humans.begin(human("recorded", file="nowhere.csv"), np.zeros((1, 2)))


@pytest.mark.parametrize(
    "names", [("LeftArm", "LeftForeArm", "LeftHand"), ("left_upper_arm", "left_forearm", "left_hand")]
)
def test_a_person_of_a_bvh_file_stands_at_the_spawn_faces_the_robot_and_reaches(
    tmp_path: Path, names: tuple[str, ...]
) -> None:
    text = Path(__file__).with_name("reach.bvh").read_text()
    for side in ("Left", "Right"):
        for old, new in zip(("Arm", "ForeArm", "Hand"), names, strict=True):
            new = new.replace("Left", side).replace("left", side.lower())
            text = text.replace(f"JOINT {side}{old}\n", f"JOINT {new}\n")
    file = tmp_path / "reach.bvh"
    file.write_text(text)
    spawn = np.array([[1.0, 1.0], [-1.2, 0.0]])
    config = human("recorded", file=str(file))
    walks = [humans.begin(config, spawn)]
    for _ in range(120):
        walks.append(humans.advance(config, walks[-1], np.zeros((2, 3)), around(np.zeros((2, 2)), no_discs(2))))
    position, yaw, limbs = (np.stack([getattr(walk, name) for walk in walks]) for name in ("position", "yaw", "limbs"))
    np.testing.assert_allclose(np.median(position[:101], axis=0), spawn, atol=0.01)
    np.testing.assert_allclose(angle_between(yaw, humans.facing_base(spawn)), 0.0, atol=1e-9)
    # The recorded person steps 0.2 m ahead and raises the right arm forwards by 80 degrees.
    away = spawn / np.linalg.norm(spawn, axis=1, keepdims=True)
    np.testing.assert_allclose(position[-1] - position[0], -0.2 * away, atol=1e-6)
    left, right = limbs[:, 0, 2], limbs[:, 0, 3]
    np.testing.assert_allclose(left, np.tile([0.0, 0.0, -1.0], (121, 1)), atol=0.4)
    raised = np.degrees(np.arctan2(right[:, 0], -right[:, 2]))
    assert raised[50] == pytest.approx(80.0, abs=0.5) and raised[-1] == pytest.approx(0.0, abs=0.5)
    np.testing.assert_allclose(np.linalg.norm(limbs[:, :, 2:], axis=-1), 1.0, atol=1e-9)


def test_a_folder_of_recordings_gives_each_its_share_and_hands_of_a_csv_are_reached(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,x,y,yaw\n0,1,0,0\n")
    hands = "left_x,left_y,left_z,right_x,right_y,right_z"
    (tmp_path / "b.csv").write_text(f"t,x,y,yaw,{hands}\n0,2,0,0,2.4,0.2,1.2,2.4,-0.2,1.2\n")
    config, traits = human("recorded", file=str(tmp_path)), np.array([[0, 0.2, 0], [0, 0.7, 0]])
    walk = humans.begin(config, np.zeros((2, 2)), traits)
    assert walk.position[:, 0].tolist() == [1.0, 2.0]
    assert np.isnan(walk.limbs[0]).all()
    hand = body.SHOULDERS + body.UPPER_ARM_M * walk.limbs[1, 2:4] + body.FOREARM_M * walk.limbs[1, 4:]
    np.testing.assert_allclose(hand, [[0.4, 0.2, 1.2], [0.4, -0.2, 1.2]], atol=1e-9)
