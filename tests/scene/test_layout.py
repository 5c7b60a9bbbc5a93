"""Goals out of reach and furniture in furniture are warned of before anything is simulated."""

from __future__ import annotations

import pytest

from hrl_comfort.cli.main import configuration, main
from hrl_comfort.composition.compose import compose
from hrl_comfort.scene.layout import layout_warnings, reach
from hrl_comfort.scene.ur import UR_ARMS

REACH_M = {"ur3e": 0.5, "ur5e": 0.85, "ur10e": 1.3}
"""Of the datasheets of the e-series."""
BALLS, PINK = "cell.places.ball_table.top_m", "cell.places.pink_table.top_m"


@pytest.mark.parametrize("arm", UR_ARMS.values(), ids=str)
def test_the_farthest_point_is_beyond_the_datasheets_reach_by_the_gripper(arm):
    shoulder, most = reach(arm.name)
    assert shoulder[2] == pytest.approx(arm.d_m[0])
    assert REACH_M[arm.name] < most < REACH_M[arm.name] + 0.3


@pytest.mark.parametrize("task", ["reach", "pick", "place", "return", "cycle", "sort", "point_to_point"])
@pytest.mark.parametrize("robot", ["ur3e", "ur10e", "jaco"])
def test_the_default_cell_suits_every_task_and_arm(task, robot):
    assert not list(layout_warnings(compose("train", [f"task={task}", f"robot={robot}"])))


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["task=pick", f"{BALLS}=[1.2,0,0.27]"], "cell.places.ball_table.top_m=[1.2, 0.0, 0.3] is 1.21 m from"),
        (["task=cycle", f"{PINK}=[0,0.3,1.5]"], "the task cannot be done"),
        (["task=reach", "task.point=fixed", "task.point_m=[0,1,0]"], "task.point_m=[0.0, 1.0, 0.0]"),
        (["task=pick", f"{BALLS}=[0.6,0,0.3]"], "cell.places.ball_table and cell.places.orange_table overlap"),
        (
            ["task=pick", "cell.obstacles.post={shape: cylinder, position_m: [0.1,0.5,0], size_m: [0.05,0.5]}"],
            "overlap",
        ),
        (["task=pick", "human.keep_out_m=0.9", "human.spawn_radius_m=[0.38,0.6]"], "people can stand nowhere"),
        (["task=pick", f"{PINK}=[0,0.1,-0.1]"], "stands in the robot's pedestal"),
        (["task=place_fine"], "task=place_fine is for cell=tray, where a gripper fits an object into a slot"),
        (["task=place_fine", "cell=grasp"], "choose cell=tray, or task=place"),
        (["task=place_fine", "cell=tray", "gripper=none"], "task=place_fine is for cell=tray, where a gripper"),
        (["task=pick", f"{PINK}=[0.1,0.45,-0.74]"], "is below the floor, which is at -0.75 m"),
    ],
)
def test_what_is_doubtful_is_warned_of(words, says):
    assert any(says in warning for warning in layout_warnings(compose("train", words)))


def test_a_fine_place_is_at_home_in_the_tray() -> None:
    assert not [each for each in layout_warnings(compose("train", ["task=place_fine", "cell=tray"])) if "fine" in each]


def test_points_that_a_task_does_not_visit_may_be_anywhere():
    assert not list(layout_warnings(compose("train", ["task=reach", "task.point=random", "task.point_m=[9,0,0]"])))
    assert not list(layout_warnings(compose("train", ["task=place", f"{BALLS}=[1.2,0,0.3]"])))
    assert list(layout_warnings(compose("train_hierarchy", [f"{PINK}=[1.2,0.3,0.3]"])))


def test_a_doubtful_command_goes_on():
    words = ["task=pick", f"{BALLS}=[1.2,0,0.3]"]
    with pytest.warns(UserWarning, match="the task cannot be done"):
        assert configuration("train", words).task.name == "pick"
    with pytest.warns(UserWarning, match="the task cannot be done"):
        assert main(["train", *words, "--dry-run"]) == 0
