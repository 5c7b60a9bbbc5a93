"""Figures of a report draw paths, goals, curves and stages as they were."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from pandas import DataFrame

from hrl_comfort import humans
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import CellConfig, RobotConfig
from hrl_comfort.config.checks import section
from hrl_comfort.files import run_folder
from hrl_comfort.plots import training
from hrl_comfort.plots.clip import gait, path_clip
from hrl_comfort.plots.paths import overview
from hrl_comfort.report import report
from hrl_comfort.scene.workcell import build_scene
from tests.humans.around import around


def test_paths_without_a_human_or_a_cell_are_drawn(demo):
    (first,) = run_folder.recorded(run_folder.find_runs(demo)[0], 1)
    alone = replace(first, path=first.path.assign(human_x=50.0, human_distance_m=np.nan))
    figure = overview([alone], {}, {})
    assert [axis.get_title(loc="left") for axis in figure.axes] == [
        "Top view",
        "Side view",
        "Horizontal distance to human",
    ]
    assert not figure.axes[2].lines


def test_the_pictures_of_a_path_are_in_time_and_the_yaw_does_not_spin(demo):
    run = run_folder.find_runs(demo)[0]
    path = run_folder.recorded(run, 1)[0].path.iloc[[0] * 101].reset_index(drop=True)
    path = path.assign(step=np.arange(101), human_yaw=np.where(np.arange(101) < 50, 3.1, -3.1))
    robot, cell = RobotConfig(**run.config["robot"]), section(CellConfig, run.config["cell"])
    clip = path_clip(path.assign(stage=np.arange(101) // 60), build_scene(robot, cell, 2), "pick", "orange")
    assert clip.duration_s == pytest.approx(2.0)
    assert np.abs(np.diff(clip.person[:, 2])).max() < 0.2
    before, after = (clip.frame(time_s).props[2] for time_s in (1.19, 1.21))
    assert before == pytest.approx(cell.goals["ball_table"])
    assert after == pytest.approx(path[["tcp_x", "tcp_y", "tcp_z"]].iloc[0])


def test_the_gait_is_the_one_that_was_simulated():
    config = compose("train", ["human=random_walk"]).human
    rng = np.random.default_rng(0)
    walk = humans.begin(config, np.array([[0.4, 0.8]]))
    nobody = humans.around(np.zeros((0, 2)), 0.0, 1)
    walks = [walk]
    for _ in range(200):
        walk = humans.advance(config, walk, rng.random((1, humans.NOISE)), around(np.zeros((1, 2)), nobody))
        walks.append(walk)
    phase, swing = gait(*np.concatenate([each.position for each in walks]).T)
    simulated = [humans.gait(each) for each in walks]
    assert phase == pytest.approx([float(each[0][0]) for each in simulated])
    assert swing == pytest.approx([float(each[1][0]) for each in simulated])
    assert 0 < swing.max() <= np.radians(25)


def test_goals_have_circles_of_the_tolerance_in_both_views(demo):
    run = run_folder.find_runs(demo)[0]
    precision = {"grasp_tolerance_m": 0.1, "place_tolerance_m": 0.02}
    figure = overview(run_folder.recorded(run, 2), run.config["cell"], precision)
    for axis in figure.axes[:2]:
        dotted = [patch for patch in axis.patches if patch.get_linestyle() == ":"]
        assert sorted(patch.radius for patch in dotted) == [0.02, 0.02, 0.1]


def test_nothing_is_drawn_with_a_single_dot(demo):
    runs = run_folder.find_runs(demo)
    assert {"learning", "checkpoints"} <= report._curves(runs).keys()
    cut = [replace(each, metrics=each.metrics[:1], checkpoints=each.checkpoints[:1]) for each in runs[:3]]
    assert not report._curves(cut)


def test_captions_say_of_lines_what_is_there():
    log = DataFrame({"policy_steps": range(5)})
    assert training.notes([log]) == ""
    assert "Thin lines" in training.notes([log, pd.concat([log] * 7)])
    assert "Dotted lines" in training.notes([log.assign(stage=list("aaabb"))])
    alone = DataFrame({"comfort_level": [1, 1], "unsafe_contact_high": 0.0})
    assert training.checkpoint_notes([alone]) == ""
    assert "Levels" in training.checkpoint_notes([alone.assign(comfort_level=[1, 2])])
    assert "chain" in training.checkpoint_notes([alone.assign(pick=[1, 2])])


def test_boundaries_of_curriculum_stages_are_drawn_and_named():
    table = DataFrame({"policy_steps": np.arange(1, 31) * 1000, "episodes": np.arange(30), "success": 0.5})
    plain = training.learning_curves({"pick": table})
    staged = training.learning_curves({"pick": table.assign(stage=["far"] * 10 + ["near"] * 20)})
    assert not [line for line in plain.axes[0].lines if line.get_linestyle() == ":"]
    dotted = [line for axis in staged.axes for line in axis.lines if line.get_linestyle() == ":"]
    assert {float(line.get_xdata()[0]) for line in dotted} == {10.0} and len(dotted) == 2
    assert [text.get_text().strip() for text in staged.axes[1].texts] == ["far", "near"]
    damaged = training.learning_curves({"pick": table.assign(stage=["far"] * 10 + ["x" * 200_000] * 20)})
    assert [text.get_text().strip() for text in damaged.axes[1].texts] == ["far", "x" * training.LONGEST]


def test_the_title_of_a_panel_of_checkpoints_says_what_its_table_has() -> None:
    table = DataFrame({"policy_steps": [1], "success": [0.5]})
    assert report._title("pick", table) == "pick\n"
    table = table.assign(split="validation", human="patrol", precision_m=0.1)
    assert report._title("pick", table) == "pick\nvalidation, human=patrol, 10 cm"
