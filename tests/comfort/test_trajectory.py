"""Metrics of an episode against values computed by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from hrl_comfort.comfort import trajectory
from hrl_comfort.comfort.trajectory import MEASURES, Trajectory, log_dimensionless_jerk, metrics
from hrl_comfort.config import CONTROL_STEP_S, FAR_AWAY_M

Floats = NDArray[np.float64]
FAR_M = 5.0


def along_x(x: list[float] | Floats) -> Floats:
    """Return tool positions (T + 1, 3) at these x, 0.3 m high."""
    x = np.asarray(x, dtype=np.float64)
    return np.stack([x, np.zeros_like(x), np.full_like(x, 0.3)], axis=-1)


def episode(tool: Floats, human: tuple[float, float] = (FAR_M, 0.0)) -> Trajectory:
    """Return an episode with a standing human at `human`, a distant arm and still joints."""
    instants = len(tool)
    return Trajectory(
        tool=tool,
        people=np.tile(np.asarray(human, dtype=np.float64), (instants, 1, 1)),
        joint_target=np.zeros((instants, 6)),
        arm_distance=np.full(instants, FAR_M),
        human_here=True,
    )


def straight(steps: int = 50) -> Trajectory:
    """Return an approach at 0.5 m/s: 1.455 m away at first, 1 cm nearer at each step."""
    return episode(along_x(-0.5 + 0.01 * np.arange(steps + 1)), human=(0.955, 0.0))


def minimum_jerk(steps: int, length_m: float = 0.4) -> Floats:
    """Return tool positions on a straight line of the minimum-jerk profile 10 s^3 - 15 s^4 + 6 s^5."""
    s = np.linspace(0.0, 1.0, steps + 1)
    return (10 * s**3 - 15 * s**4 + 6 * s**5)[:, None] * length_m * np.array([0.6, 0.0, 0.8])


def test_every_measure_is_returned_under_its_name_and_in_order() -> None:
    assert tuple(metrics(straight())) == MEASURES
    assert tuple(metrics(replace(straight(), human_here=False))) == MEASURES


def test_a_straight_path_has_its_length_and_its_distances() -> None:
    found = metrics(straight())
    assert found["tool_path_m"] == pytest.approx(0.5)
    assert found["waiting_share"] == 0
    assert found["human_distance_mean_m"] == pytest.approx(1.455 - 0.01 * 25.5)
    assert found["human_distance_min_m"] == pytest.approx(0.955)
    assert found["human_distance_by_path_m"] == pytest.approx(1.2)


def test_distance_is_horizontal_and_leaves_out_the_instant_before_the_first_step() -> None:
    tool = along_x([0.0, 1.0, 1.0])
    tool[:, 2] = [0.0, 0.5, 2.0]
    found = metrics(episode(tool, human=(1.0, 0.7)))
    assert found["human_distance_mean_m"] == found["human_distance_min_m"] == pytest.approx(0.7)
    assert found["tool_path_m"] == pytest.approx(math.hypot(1.0, 0.5) + 1.5)


def test_zones_are_those_of_the_nearest_link_and_far_away_belongs_to_none() -> None:
    arm = np.array([0.2, 0.4, -0.01, 1.3, 8.3])
    far = metrics(replace(straight(4), arm_distance=arm))
    shares = [far[f"zone_{name}"] for name in ("intimate", "personal", "social")]
    assert shares == [0.5, 0.0, 0.25]
    borders = metrics(replace(straight(4), arm_distance=np.array([0.2, 0.45, 1.2, 3.6, 0.44])))
    assert [borders[f"zone_{name}"] for name in ("intimate", "personal", "social")] == [0.25, 0.25, 0.25]


def test_steps_slower_than_a_centimetre_a_second_are_waiting() -> None:
    lengths = np.array([0.0, 0.005, 0.009, 0.011, 0.5]) * CONTROL_STEP_S
    found = metrics(episode(along_x(np.concatenate([[0.0], lengths.cumsum()]))))
    assert found["waiting_share"] == pytest.approx(3 / 5)


def test_distance_by_path_counts_only_where_the_tool_goes() -> None:
    # 1.0, 1.0, 0.9, 0.7 m after steps of 0, 0, 0.1, 0.2 m.
    found = metrics(episode(along_x([0.0, 0.0, 0.0, 0.1, 0.3]), human=(1.0, 0.0)))
    assert found["human_distance_by_path_m"] == pytest.approx((0.9 * 0.1 + 0.7 * 0.2) / 0.3)
    assert found["human_distance_mean_m"] == pytest.approx(0.9)


def test_joint_increments_are_the_largest_of_a_step_whichever_way() -> None:
    steps = np.radians([[2.0, 0, 0, 0.5, 0, 0], [0, 0, -1.0, 0, 0, 0.5], [0, 0, 0, 0, 0, 0]])
    targets = np.concatenate([np.full((1, 6), 0.3), 0.3 + steps.cumsum(axis=0)])
    found = metrics(replace(straight(3), joint_target=targets))
    assert found["joint_increment_mean_deg"] == pytest.approx(1.0)
    assert found["joint_increment_max_deg"] == pytest.approx(2.0)


# ---- closing in ----------------------------------------------------------------------------------------


def test_time_to_contact_of_a_robot_that_approaches_is_distance_over_speed() -> None:
    # 0.5 m/s from 1.005 m: 1 cm a step, below 0.25 m (half a second) after 76 of 90 steps.
    found = metrics(replace(straight(90), arm_distance=1.005 - 0.01 * np.arange(91)))
    assert found["time_to_contact_min_s"] == pytest.approx(0.105 / 0.5)
    assert found["time_to_contact_short"] == pytest.approx(15 / 90)


def test_a_robot_that_backs_away_or_stands_has_no_time_to_contact() -> None:
    for arm in (0.3 + 0.01 * np.arange(51), np.full(51, 0.3), 0.3 - 1e-9 * np.arange(51)):
        found = metrics(replace(straight(), arm_distance=arm))
        assert found["time_to_contact_min_s"] is None
        assert found["time_to_contact_short"] == 0


def test_a_jolt_of_one_step_counts_a_tenth_of_its_speed() -> None:
    # 2 cm in one step is 1 m/s, but 0.1 m/s over 0.2 s.
    arm = np.where(np.arange(51) < 25, 0.52, 0.5)
    found = metrics(replace(straight(), arm_distance=arm))
    assert found["time_to_contact_min_s"] == pytest.approx(0.5 / 0.1)
    jolted = straight()
    jolted.people[25:, :, 0] += 0.02
    still = metrics(replace(straight(), arm_distance=np.full(51, 1.0)))["separation_margin_observed_min_m"]
    moved = metrics(replace(jolted, arm_distance=np.full(51, 1.0)))["separation_margin_observed_min_m"]
    assert still is not None and moved == pytest.approx(still - 0.1 * 0.2)


def test_time_to_contact_is_zero_in_contact() -> None:
    found = metrics(replace(straight(2), arm_distance=np.array([0.02, 0.01, -0.001])))
    assert found["time_to_contact_min_s"] == 0


def test_protective_distance_is_the_standards_sum() -> None:
    # v_r = 1 m/s stops in 0.2 s over 0.1 m, after 0.1 s of reaction.
    at = trajectory.protective_distance(np.array([1.0]), 1.6).item()
    assert at == pytest.approx(1.6 * (0.1 + 0.2) + 1.0 * 0.1 + 0.1)
    assert trajectory.protective_distance(np.array([1.0]), 0.0).item() == pytest.approx(0.2)
    assert trajectory.protective_distance(np.array([0.0]), 1.6).item() == pytest.approx(0.16)


def test_separation_margin_takes_the_worst_and_the_observed_walker() -> None:
    # v_r = 0.5 m/s stops in 0.1 s over 0.025 m; the person walks at 1 m/s.
    walker = np.stack([FAR_M + 0.02 * np.arange(51), np.zeros(51)], axis=-1)
    arm = np.where(np.arange(51) == 20, 0.6, 2.0)
    found = metrics(replace(straight(), people=walker[:, None], arm_distance=arm))
    robot = 0.5 * 0.1 + 0.025
    assert found["separation_margin_min_m"] == pytest.approx(0.6 - 1.6 * 0.2 - robot)
    assert found["separation_margin_observed_min_m"] == pytest.approx(0.6 - 1.0 * 0.2 - robot)
    assert found["separation_margin_negative"] == found["separation_margin_observed_negative"] == 0
    # S_p is 0.395 m beside a person at 1.6 m/s, 0.275 m beside this one.
    near = np.select([np.arange(51) % 5 == 0, np.arange(51) % 5 == 1], [0.2, 0.3], 2.0)
    shares = metrics(replace(straight(), people=walker[:, None], arm_distance=near))
    assert shares["separation_margin_negative"] == pytest.approx(0.4)
    assert shares["separation_margin_observed_negative"] == pytest.approx(0.2)
    assert found["arm_distance_min_m"] == pytest.approx(0.6)
    assert found["arm_distance_mean_m"] == pytest.approx((49 * 2.0 + 0.6) / 50)


def test_tool_speed_near_is_that_of_the_steps_with_the_arm_in_the_intimate_zone() -> None:
    tool, arm = along_x([0.0, 0.01, 0.03, 0.06]), np.array([0.1, 0.5, 0.44, 0.2])
    assert metrics(replace(episode(tool), arm_distance=arm))["tool_speed_near_m_s"] == pytest.approx(1.25)
    assert metrics(episode(tool))["tool_speed_near_m_s"] is None


# ---- smoothness ----------------------------------------------------------------------------------------


def test_log_dimensionless_jerk_of_minimum_jerk_is_its_integral() -> None:
    # With unit length and time: jerk 60 - 360 s + 360 s^2, peak speed 15/8, integral of its square 720.
    s = (np.arange(20_000) + 0.5) / 20_000
    integral = ((60 - 360 * s + 360 * s**2) ** 2).mean()
    assert integral == pytest.approx(720, rel=1e-6)
    expected = -math.log(integral / (15 / 8) ** 2)
    assert log_dimensionless_jerk(minimum_jerk(1500)) == pytest.approx(expected, abs=0.02)


def test_log_dimensionless_jerk_is_of_the_shape_not_of_length_or_duration() -> None:
    once = log_dimensionless_jerk(minimum_jerk(400))
    assert log_dimensionless_jerk(minimum_jerk(400, length_m=0.8)) == pytest.approx(once)
    assert log_dimensionless_jerk(minimum_jerk(800)) == pytest.approx(once, abs=0.03)


def test_a_trembling_tool_is_less_smooth() -> None:
    tremble = minimum_jerk(400)
    tremble[:, 1] += 1e-3 * np.sin(np.arange(401))
    assert log_dimensionless_jerk(tremble) < log_dimensionless_jerk(minimum_jerk(400)) - 1


@pytest.mark.parametrize(
    "tool",
    [
        along_x([0.0, 0.1, 0.3]),  # two steps
        np.tile([0.1, 0.2, 0.3], (50, 1)),  # never moves
        np.tile([0.1, 0.2, 0.3], (50, 1)) + 1e-12 * np.random.default_rng(0).random((50, 3)),
        along_x(0.01 * np.arange(51)),  # no jerk but that of rounding
    ],
    ids=["short", "still", "still to rounding", "constant"],
)  # fmt: skip
def test_without_motion_or_jerk_there_is_no_smoothness(tool: Floats) -> None:
    assert log_dimensionless_jerk(tool) is None
    assert metrics(episode(tool))["log_dimensionless_jerk"] is None


# ---- missing values ------------------------------------------------------------------------------------


def test_without_a_human_the_metrics_of_the_human_are_none() -> None:
    instants = len(straight().tool)
    alone = replace(straight(), people=np.full((instants, 1, 2), FAR_AWAY_M), human_here=False)
    found = metrics(alone)
    of_motion = ("tool_path_m", "waiting_share", "joint_increment_mean_deg", "joint_increment_max_deg")
    assert all(found[name] is not None for name in of_motion)
    assert {found[name] for name in MEASURES[5:]} == {None}


def test_one_step_is_enough_for_all_but_smoothness_and_what_needs_motion() -> None:
    found = metrics(episode(along_x([0.0, 0.0])))
    missing = {name for name, value in found.items() if value is None}
    assert missing == {
        "log_dimensionless_jerk", "human_distance_by_path_m", "tool_speed_near_m_s", "tool_speed_beside_m_s",
        "time_to_contact_min_s",
    }  # fmt: skip
    assert all(np.isfinite(value) for value in found.values() if value is not None)
