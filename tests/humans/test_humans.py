"""Humans: motions, bounds, spawns, observed position and the committed evaluation set."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hrl_comfort import humans
from hrl_comfort.config import CONTROL_STEP_S, FAR_AWAY_M, ConfigError, HumanConfig
from hrl_comfort.humans import body
from hrl_comfort.humans.evaluation import FIRST_SEED
from hrl_comfort.humans.make_evaluation_set import default_choices, evaluation_set
from tests.humans.around import STATIONS, around

REPOSITORY = Path(__file__).resolve().parents[2]
GOALS = np.array([[-0.615, -0.070], [0.647, -0.055], [0.126, 0.453]])
# The authors' scene, reference code of 10.1109/ACCESS.2024.3451663.
SPAWNS = [
    [0.18, -0.64], [0.49, 0.22], [-0.30, 0.28], [0.10, 0.73], [-0.44, -0.35], [-0.17, -0.62], [1.00, -0.66],
    [0.55, -0.39], [-0.28, 0.28], [0.49, 0.29], [0.10, 0.73], [0.60, -0.55], [0.10, -0.54], [-0.42, 0.28],
    [0.74, 0.56], [-0.53, 0.35], [-0.28, -0.66], [-0.91, 0.13], [0.20, -0.72],
]  # fmt: skip
HUMAN = HumanConfig(
    motion="random_walk", spawns_m=SPAWNS, held_out=[3, 5, 7, 10, 11, 14, 16, 17], spawn="points",
    spawn_jitter_m=0.1, spawn_radius_m=[0.38, 1.1], spawn_margin_m=0.1, keep_out_m=0.35, bound_m=0.5,
    jitter_m=0.015, forward_m=0.008, forward_probability=0.02, arc_deg=30.0, arc_steps=500, speed_m_s=0.5,
    acceleration_m_s2=None, curiosity=0.5, mixture={}, others={}, partitioned=False, file=None, clipping="off",
    stations_m=None, stay_s=4.0,
)  # fmt: skip
PAPER = ("still", "random_walk", "arc", "approach", "patrol")
"""Motions that jump: they stay within `bound_m` of the spawn and are cut at keep-out discs."""


def human(motion: str, **changes: object) -> HumanConfig:
    return replace(HUMAN, motion=motion, **changes)


def discs(rows: int) -> humans.KeepOut:
    return humans.around(GOALS, HUMAN.keep_out_m, rows)


def no_discs(rows: int) -> humans.KeepOut:
    return humans.KeepOut(np.zeros((rows, 0, 2)), 0.35)


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


# ---- motions ---------------------------------------------------------------------------------------------


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
    text = (REPOSITORY / "tests" / "humans" / "reach.bvh").read_text()
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


# ---- spawns ----------------------------------------------------------------------------------------------


def test_five_spawns_of_the_authors_are_moved_out_to_the_keep_out_distance_and_no_others() -> None:
    moved = humans.moved_spawns(HUMAN, GOALS)
    shift = np.linalg.norm(moved - np.array(SPAWNS), axis=1)
    assert np.flatnonzero(shift).tolist() == [1, 3, 4, 7, 10]
    np.testing.assert_allclose(shift[[1, 3, 4, 7, 10]], [0.0333, 0.0718, 0.0198, 0.0012, 0.0718], atol=1e-4)
    assert np.linalg.norm(moved[:, None] - discs(1).centres, axis=-1).min() >= HUMAN.keep_out_m


def test_points_in_overlapping_discs_go_to_the_nearest_free_point() -> None:
    rng = np.random.default_rng(5)
    centres = rng.uniform(-0.5, 0.5, (300, 3, 2))
    points = rng.uniform(-0.6, 0.6, (300, 2))
    keep_out = humans.KeepOut(centres, 0.35)
    moved = humans.outside(points, keep_out)
    assert not keep_out.entered(moved).any()
    np.testing.assert_array_equal(moved[~keep_out.entered(points)], points[~keep_out.entered(points)])
    grid = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 201)] * 2), axis=-1).reshape(-1, 2)
    for i in range(0, 300, 10):
        free = (np.linalg.norm(grid[:, None] - centres[i], axis=-1) >= 0.351).all(axis=1)
        nearest = np.linalg.norm(grid[free] - points[i], axis=1).min()
        assert np.linalg.norm(moved[i] - points[i]) <= nearest


def test_a_point_in_the_centre_of_a_disc_moves_to_its_rim() -> None:
    keep_out = humans.KeepOut(np.zeros((1, 2, 2)), 0.35)
    assert np.linalg.norm(humans.outside(np.zeros((1, 2)), keep_out)) == pytest.approx(0.35, abs=1e-5)


def test_training_uses_every_spawn_that_is_not_held_out() -> None:
    assert humans.training_spawns(HUMAN).tolist() == [0, 1, 2, 4, 6, 8, 9, 12, 13, 15, 18]


def test_jitter_fills_its_disc_evenly() -> None:
    u = np.random.default_rng(6).random((20_000, 2))
    offset = humans.jittered_spawn(HUMAN, np.tile([2.0, 2.0], (len(u), 1)), u) - 2.0
    radius = np.linalg.norm(offset, axis=1)
    assert radius.max() <= HUMAN.spawn_jitter_m + 1e-12
    assert np.mean(radius < HUMAN.spawn_jitter_m / 2) == pytest.approx(0.25, abs=0.01)
    np.testing.assert_allclose(offset.mean(axis=0), 0.0, atol=2e-3)


def test_a_spawn_anywhere_is_in_its_ring_and_clear_of_discs_and_held_out_points() -> None:
    rng, spawns = np.random.default_rng(7), humans.moved_spawns(HUMAN, GOALS)
    chosen = replace(HUMAN, spawn="anywhere")
    places = np.stack([humans.training_spawn(chosen, spawns, discs(1), rng)[1] for _ in range(2000)])
    radius = np.linalg.norm(places, axis=1)
    assert radius.min() >= 0.38
    assert radius.max() <= 1.1
    assert not discs(2000).entered(places).any()
    to_held_out = np.linalg.norm(places[:, None] - spawns[HUMAN.held_out], axis=-1)
    assert to_held_out.min() >= HUMAN.spawn_margin_m
    quadrants = np.bincount((places[:, 0] > 0) * 2 + (places[:, 1] > 0), minlength=4)
    assert quadrants.min() > 200, "every side of the robot is visited"


@pytest.mark.parametrize(("spawn", "share"), [("points", 1.0), ("mixed", 0.5), ("anywhere", 0.0)])
def test_training_spawns_are_at_training_points_or_anywhere(spawn: str, share: float) -> None:
    rng, spawns, config = (
        np.random.default_rng(9),
        humans.moved_spawns(HUMAN, GOALS),
        replace(HUMAN, spawn=spawn),
    )
    drawn = [humans.training_spawn(config, spawns, discs(1), rng) for _ in range(1000)]
    indices = np.array([index for index, _ in drawn])
    assert np.mean(indices >= 0) == pytest.approx(share, abs=0.05)
    assert not set(indices) & set(HUMAN.held_out)
    places = np.stack([place for _, place in drawn])
    to_held_out = np.linalg.norm(places[:, None] - spawns[HUMAN.held_out], axis=-1)
    assert to_held_out.min() >= HUMAN.spawn_margin_m


def test_a_ring_without_room_is_refused_and_named() -> None:
    config = replace(HUMAN, spawn="anywhere", spawn_radius_m=[0.1, 0.2])
    with pytest.raises(ConfigError, match=r"human\.spawn_radius_m=\[0\.1, 0\.2\]"):
        humans.training_spawn(config, np.array(SPAWNS), discs(1), np.random.default_rng(8))


# ---- observed position -----------------------------------------------------------------------------------


def test_clipping_off_gives_the_true_position() -> None:
    position = np.array([[0.7, 0.1]])
    np.testing.assert_array_equal(humans.seen_position(HUMAN, position, np.array(SPAWNS)), position)


def test_full_clipping_snaps_to_the_nearest_spawn_and_partial_only_to_a_nearer_one() -> None:
    spawns = np.array([[1.0, 0.0], [0.0, 1.0]])
    position = np.array([[1.2, 0.1], [0.8, 0.1], [0.1, 1.3]])
    full = humans.seen_position(replace(HUMAN, clipping="full"), position, spawns)
    np.testing.assert_array_equal(full, [[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    partial = humans.seen_position(replace(HUMAN, clipping="partial"), position, spawns)
    np.testing.assert_array_equal(partial, [[1.0, 0.0], [0.8, 0.1], [0.0, 1.0]])


@pytest.mark.parametrize("clipping", ["off", "full", "partial"])
def test_an_absent_human_is_observed_far_away(clipping: str) -> None:
    config = replace(HUMAN, clipping=clipping, motion="none")
    position = humans.begin(config, np.array([[0.9, 0.3], [0.5, 0.5]])).position
    seen = humans.seen_position(config, position, np.array(SPAWNS))
    np.testing.assert_array_equal(seen, [[FAR_AWAY_M, 0.0]] * 2)


# ---- the evaluation set ----------------------------------------------------------------------------------


def committed() -> str:
    return (REPOSITORY / "hrl_comfort" / "humans" / "evaluation_set.csv").read_text(encoding="utf-8")


def test_remaking_the_evaluation_set_gives_the_committed_file() -> None:
    text = evaluation_set(*default_choices(REPOSITORY / "conf"))
    assert text == committed(), "remake it: python -m hrl_comfort.humans.make_evaluation_set"


def test_the_defaults_in_conf_are_the_authors_cell() -> None:
    config, cell = default_choices(REPOSITORY / "conf")
    assert config.spawns_m == SPAWNS
    np.testing.assert_array_equal(np.array(list(cell.goals.values()))[:, :2], GOALS)


def test_half_of_the_evaluation_set_was_never_a_spawn_in_training() -> None:
    config, _ = default_choices(REPOSITORY / "conf")
    entries = humans.load_evaluation_set()
    assert len(entries.episode) == 1000
    assert entries.seen.sum() == 500
    assert entries.seen[:100].sum() == 50, "a leading part is balanced too"
    assert set(entries.spawn_id[entries.seen]) == set(humans.training_spawns(config))
    assert set(entries.spawn_id[~entries.seen]) == set(config.held_out)
    spawns = humans.moved_spawns(config, GOALS)
    strayed = np.linalg.norm(entries.position - spawns[entries.spawn_id], axis=1)
    assert strayed[entries.seen].max() <= config.spawn_jitter_m + 1e-5


def test_no_unseen_entry_lies_where_training_spawns_people() -> None:
    config, _ = default_choices(REPOSITORY / "conf")
    entries = humans.load_evaluation_set()
    held_out = humans.moved_spawns(config, GOALS)[entries.spawn_id[~entries.seen]]
    strayed = np.linalg.norm(entries.position[~entries.seen] - held_out, axis=1)
    assert config.spawn == "mixed"
    assert strayed.max() < config.spawn_margin_m, "training keeps that far from the held-out points"


def test_evaluation_episodes_begin_outside_the_keep_out_discs_with_seeds_of_their_own() -> None:
    entries = humans.load_evaluation_set()
    assert not discs(1000).entered(entries.position).any()
    assert entries.episode_seed.min() >= FIRST_SEED
    for column in (entries.episode, entries.episode_seed, entries.motion_id):
        assert len(np.unique(column)) == 1000


def test_a_part_of_the_set_and_other_seeds_keep_spawns_and_motions() -> None:
    entries = humans.load_evaluation_set()
    part = entries.part(10, 14).reseeded(5_000_000)
    assert part.episode.tolist() == [10, 11, 12, 13]
    assert part.episode_seed.tolist() == [5_000_010, 5_000_011, 5_000_012, 5_000_013]
    np.testing.assert_array_equal(part.position, entries.position[10:14])
    np.testing.assert_array_equal(part.motion_id, entries.motion_id[10:14])
