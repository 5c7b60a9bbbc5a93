import ast
import base64
import csv
import json
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from pandas import DataFrame

from hrl_comfort import humans
from hrl_comfort.analysis.episodes import terminations
from hrl_comfort.analysis.summary import summarise, with_totals
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import CellConfig, ConfigError, ReportConfig, RobotConfig
from hrl_comfort.config.checks import section
from hrl_comfort.files import run_folder
from hrl_comfort.files.atomic import write_json
from hrl_comfort.files.tables import read_table, records_of
from hrl_comfort.plots import training, video
from hrl_comfort.plots.clip import gait, path_clip
from hrl_comfort.plots.paths import overview
from hrl_comfort.plots.tape import Tape
from hrl_comfort.report import report
from hrl_comfort.report import videos as module
from hrl_comfort.report.texts import summary
from hrl_comfort.report.videos import videos
from hrl_comfort.scene.camera import PicturesUnavailableError
from hrl_comfort.scene.workcell import build_scene
from tests.cells import SECTION
from tests.humans.around import around

CONFIG = f"""\
robot: {{name: ur3e, home_deg: [0, -90, 0, 0, 90, 0], rating: paper}}
{SECTION}task: {{name: NAME}}
"""
ROUTE = {"pick": (0, 1), "place": (1, 2), "return": (2, 3), "cycle": (0, 1, 2, 3)}
POINTS = np.array([[0.3, -0.1, 0.35], [-0.55, -0.1, 0.3], [0.6, -0.05, 0.3], [0.3, -0.1, 0.35]])


def write(file: Path, rows: list[dict[str, object]]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("w", newline="") as out:
        writer = csv.DictWriter(out, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def make_training(folder: Path, rng: np.random.Generator, rows: int) -> None:
    share = 1 - np.exp(-np.linspace(0, 4, rows))
    noisy = np.clip(share + rng.normal(0, 0.05, rows), 0, 1)
    precision = 0.3 - 0.04 * np.floor(np.linspace(0, 5, rows))
    write(
        folder / "metrics.csv",
        [
            {
                "policy_steps": 1000 * i,
                "updates": 250 * i,
                "episodes": 20 * i,
                "precision_m": max(0.1, precision[i]),
                "success": noisy[i] if i else "",
                "return": 15 * noisy[i] - 3,
                "steps": 120,
                "contact": 0.1 * (1 - noisy[i]),
                "other_collision": 0,
                "critic_loss": 0.1,
                "entropy": -6 * share[i],
                "q_mean": 10 * share[i],
            }
            for i in range(rows)
        ],
    )
    write(folder / "timing.csv", [{"policy_steps": 1000 * i, "seconds": 6 * i} for i in range(rows)])
    (folder / "provenance.json").write_text(json.dumps({"finished": True, "commit": "abc123", "machine": {"cores": 2}}))
    write(
        folder / "eval" / "checkpoints.csv",
        [
            {
                "policy_steps": 20000 * (i + 1),
                "success": s,
                "success_low": s - 0.06,
                "success_high": min(1, s + 0.04),
                "precision_m": 0.1,
            }
            for i, s in enumerate((0.2, 0.6, 0.85, 0.97))
        ],
    )


def make_evaluation(folder: Path, task: str, rng: np.random.Generator, episodes: int) -> None:
    rows, paths, options = [], [], []
    for i in range(episodes):
        failed = i % 7 == 3
        steps = 90 * (len(ROUTE[task]) - 1) + int(rng.integers(20))
        rows.append(
            {
                "task": task,
                "policy": f"runs/demo/{task}",
                "train_seed": 0,
                "episode_seed": 1000000,
                "episode": i,
                "object": "orange",
                "spawn_id": i % 19,
                "motion_id": i,
                "seen": i % 2,
                "comfort_level": "",
                "human": "random_walk",
                "precision_m": 0.1,
                "success": int(not failed),
                "steps": steps,
                "policy_steps": steps // 5,
                "return": 11.0,
                "human_distance_mean_m": 0.8 + 0.1 * rng.random(),
                "human_distance_min_m": 0.4,
                "contact": int(failed),
                "unsafe_contact": int(failed),
                "other_collision": "none",
                "truncated": 0,
            }
        )
        legs = len(ROUTE[task]) - 1
        for leg in range(legs):
            start, end = leg * steps // legs, (leg + 1) * steps // legs
            options.append(
                {
                    "episode": i,
                    "option": list(ROUTE)[leg],
                    "attempt": 1,
                    "start_step": start,
                    "end_step": end,
                    "termination": "failure" if failed and leg == legs - 1 else "success",
                }
            )
        if i < 5:
            when = np.linspace(0, legs, steps)
            nodes = POINTS[list(ROUTE[task])]
            tool = np.stack([np.interp(when, np.arange(legs + 1), nodes[:, k]) for k in range(3)], axis=1)
            tool[:, 2] += 0.08 * np.sin(np.pi * (when % 1))
            human = np.array([0.2 + 0.1 * i, 0.75 - 0.3 * i]) + np.cumsum(rng.normal(0, 0.006, (steps, 2)), axis=0)
            for step in range(steps):
                paths.append(
                    {
                        "episode": i,
                        "step": step,
                        "stage": min(int(when[step]), legs - 1),
                        **{f"q{j}": q for j, q in enumerate((3 - when[step], -1.2, 1.0, 0.2, 1.57, 0))},
                        **dict(zip(("tcp_x", "tcp_y", "tcp_z"), tool[step], strict=True)),
                        "human_x": human[step, 0],
                        "human_y": human[step, 1],
                        "human_yaw": np.arctan2(-human[step, 1], -human[step, 0]),
                        "human_distance_m": np.hypot(*(tool[step, :2] - human[step])),
                    }
                )
    write(folder / "eval" / "episodes.csv", rows)
    write(folder / "eval" / "paths.csv", paths)
    if task == "cycle":
        write(folder / "eval" / "options.csv", options)
    write_json(folder / "eval" / "summary.json", summarise(records_of(rows, "episodes"), [], 500))


def make_demo(folder: Path, rows: int = 40, episodes: int = 21) -> Path:
    rng = np.random.default_rng(0)
    for task in ROUTE:
        (folder / task).mkdir(parents=True)
        (folder / task / "config.yaml").write_text(CONFIG.replace("NAME", task))
        if task != "cycle":
            make_training(folder / task, rng, rows)
        make_evaluation(folder / task, task, rng, episodes)
    return folder


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    return make_demo(tmp_path_factory.mktemp("runs") / "demo")


@pytest.fixture(scope="module")
def page(demo):
    return report.report(ReportConfig(run=str(demo), output=None, video=False)).read_text()


def test_the_page_needs_no_other_file_and_is_small(page):
    sources = re.findall(r'(?:src|href)="([^"]{5})', page)
    assert len(sources) > 5
    assert set(sources) == {"data:"}
    assert len(page) < 5_000_000


def test_every_figure_is_a_readable_svg(page):
    figures = re.findall(r'src="data:image/svg\+xml;base64,([^"]+)"', page)
    assert all(b"</svg>" in base64.b64decode(figure) for figure in figures)
    assert len(figures) == 3 + 4 + 1  # training, paths of four tasks, timeline


def test_runs_come_in_the_order_of_the_work(demo):
    assert [run.name for run in run_folder.find_runs(demo)] == ["pick", "place", "return", "cycle"]


def test_the_headline_holds_each_task_with_interval_and_training_minutes(demo):
    rows = {row["task"]: row for row in report.headline(run_folder.find_runs(demo))}
    assert rows["pick"]["success (%)"].startswith("85.7 [")
    assert rows["pick"]["training (min)"] == "3.9"
    assert rows["cycle"]["training (min)"] == "–"


def test_a_run_without_anything_but_metrics_says_what_is_missing(tmp_path):
    make_training(tmp_path / "pick", np.random.default_rng(0), 5)
    shutil.rmtree(tmp_path / "pick" / "eval")
    text = report.report(ReportConfig(run=str(tmp_path / "pick"), output=None, video=True)).read_text()
    for name in ("eval/summary.json", "eval/paths.csv", "eval/episodes.csv", "config.yaml"):
        assert re.search(rf"(no|needs|and) {name}", text, re.IGNORECASE), name


def test_text_of_a_run_is_escaped(tmp_path):
    make_training(tmp_path / "pick", np.random.default_rng(0), 5)
    (tmp_path / "pick" / "config.yaml").write_text("task: {name: '<script>alert(1)</script>'}\n")
    text = report.report(ReportConfig(run=str(tmp_path), output=None, video=False)).read_text()
    assert "<script>" not in text
    assert "&lt;script&gt;" in text


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


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"success": "1"}, "success"),
        ({"contact": "1", "unsafe_contact": "0"}, "contact"),
        ({"contact": "1", "unsafe_contact": "1"}, "unsafe contact"),
        ({"other_collision": "table"}, "hit table"),
        ({"truncated": "1"}, "time limit"),
        ({}, "other"),
    ],
)
def test_endings_are_told_apart(changes, words):
    row = {"episode": "0", "success": "0", "contact": "0", "other_collision": "none", **changes}
    assert list(terminations(records_of([row], "episodes"))) == [words]


def test_a_lone_policy_has_no_option_timeline(tmp_path):
    make_evaluation(tmp_path / "cycle", "cycle", np.random.default_rng(0), 3)
    options = tmp_path / "cycle" / "eval" / "options.csv"
    assert len(report._timelines(run_folder.find_runs(tmp_path))) == 1
    options.write_text("episode,option,attempt,start_step,end_step,termination\n0,pick,1,0,90,success\n")
    assert report._timelines(run_folder.find_runs(tmp_path)) == []


def test_the_configuration_of_the_evaluation_rules_over_that_of_training(tmp_path):
    (tmp_path / "eval").mkdir()
    (tmp_path / "config.yaml").write_text("task: {name: pick}\n")
    (tmp_path / "eval" / "config.yaml").write_text("task: {name: cycle}\n")
    (tmp_path / "eval" / "episodes.csv").write_text("episode,success\n0,True\n")
    run = run_folder.read_run(tmp_path)
    assert run.config["task"]["name"] == "cycle"
    assert list(run.configs) == ["training", "evaluation"]


def test_of_the_many_failures_of_several_runs_the_page_shows_some_and_counts_all(demo, tmp_path):
    folder, count = tmp_path / "demo", 0
    shutil.copytree(demo, folder)
    for file in folder.glob("*/eval/episodes.csv"):
        failed = pd.concat([read_table(file)] * 3).assign(success=False, truncated=True)
        failed.to_csv(file, index=False)
        count += len(failed)
    page = report.report(ReportConfig(run=str(folder), output=None, video=False)).read_text()
    assert f"{count} failed episodes, the first 40" in page


def test_a_folder_without_runs_is_named(tmp_path):
    with pytest.raises(ConfigError, match="holds no run"):
        report.report(ReportConfig(run=str(tmp_path), output=None, video=False))
    with pytest.raises(ConfigError, match="is not a folder"):
        report.report(ReportConfig(run=str(tmp_path / "no"), output=None, video=False))


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


def levels_of(demo, folder):
    shutil.copytree(demo / "pick", folder)
    for name, key in (("paths", "level"), ("episodes", "comfort_level")):
        table = pd.read_csv(folder / "eval" / f"{name}.csv")
        levels = [table.assign(**{key: level}) for level in (1, 4, 10)]
        pd.concat(levels).to_csv(folder / "eval" / f"{name}.csv", index=False)
    summary = summarise(read_table(folder / "eval" / "episodes.csv"), ["seen"], 500)
    write_json(folder / "eval" / "summary.json", summary)
    return run_folder.find_runs(folder)


def test_levels_have_totals_beside_seen_and_unseen_and_the_first_sentence_names_the_ends(demo, tmp_path):
    runs = levels_of(demo, tmp_path / "pick")
    rows = report.headline(runs)
    assert [(row["comfort level"], row["spawns"], row["episodes"]) for row in rows] == [
        (level, *of) for level in ("1", "4", "10") for of in (("unseen", "11"), ("seen", "10"), ("all", "21"))
    ]
    assert [len(report._level_paths(each)) for each in (runs, run_folder.find_runs(demo))] == [1, 0]
    said = summary(runs[0])
    assert said.startswith("Pick at level 1 beside people (random_walk) succeeds in 85.7 % [")
    assert "Pick at level 10 " in said and "level 4" not in said


def test_the_first_sentence_says_success_steps_and_contacts_with_their_intervals(demo, page):
    (cycle,) = (run for run in run_folder.find_runs(demo) if run.name == "cycle")
    number = r"\d+\.\d % \[\d+\.\d, \d+\.\d\]"
    wanted = (
        rf"Cycle beside people \(random_walk\) succeeds in {number} of 21 episodes, after \d+ control steps \(.* s\)"
    )
    wanted += rf" on average; the arm touches the person in {number} and unsafely in {number}\."
    assert re.fullmatch(wanted, summary(cycle)) and summary(cycle) in page
    alone = [{**group, "human": "none"} for group in cycle.groups]
    assert "touches" not in summary(replace(cycle, groups=alone, episodes=None))
    seen = [{**cycle.groups[0], "seen": True}]
    assert summary(replace(cycle, groups=seen, episodes=None)) == summary(replace(cycle, groups=cycle.groups[:1]))
    busy = [{**group, "metrics": {**group["metrics"], "objects_per_min": {"mean": 3, "ci95": None}}} for group in alone]
    assert "places 3.00 objects a minute in 21 episodes." in summary(replace(cycle, groups=busy, episodes=None))


def test_both_tables_count_the_same_contacts_whatever_ended_the_episode(demo):
    episodes = run_folder.find_runs(demo)[0].episodes.assign(run="pick")
    late = episodes.assign(truncated=True, contact=episodes["episode"] < 9, unsafe_contact=False)
    late["ended"] = terminations(late)
    heads, (line,) = report._endings(late)
    told = dict(zip(heads, line, strict=True))
    assert "contact" not in told, "none ended an episode"
    share = summarise(late, [], 500)["groups"][0]["metrics"]["contact"]["mean"]
    assert (told["episodes"], told["with a contact"]) == ("21", f"{21 * share:.0f}") == ("21", "9")


def test_captions_say_of_lines_what_is_there():
    log = DataFrame({"policy_steps": range(5)})
    assert training.notes([log]) == ""
    assert "Thin lines" in training.notes([log, pd.concat([log] * 7)])
    assert "Dotted lines" in training.notes([log.assign(stage=list("aaabb"))])
    alone = DataFrame({"comfort_level": [1, 1], "unsafe_contact_high": 0.0})
    assert training.checkpoint_notes([alone]) == ""
    assert "Levels" in training.checkpoint_notes([alone.assign(comfort_level=[1, 2])])
    assert "chain" in training.checkpoint_notes([alone.assign(pick=[1, 2])])


def test_every_evaluation_of_a_run_is_found_and_checkpoints_are_drawn_by_level(demo, tmp_path):
    folder = tmp_path / "pick"
    shutil.copytree(demo / "pick", folder)
    table = read_table(folder / "eval" / "checkpoints.csv")
    assert table is not None
    (folder / "eval_validation").mkdir()
    levels = pd.concat([table.assign(comfort_level=level, split="validation") for level in (1, 10)])
    levels.to_csv(folder / "eval_validation" / "checkpoints.csv", index=False)
    runs = run_folder.find_runs(folder)
    assert [run.name for run in runs] == ["pick", "pick/eval_validation"]
    figure = training.by_checkpoint({run.name: run.checkpoints for run in runs if run.checkpoints is not None})
    assert [text.get_text() for text in figure.legends[0].texts] == ["level 1", "level 10", "no level"]
    drawn = [[line for line in axis.containers if line.has_yerr and len(line[0].get_xdata())] for axis in figure.axes]
    assert [len(each) for each in drawn] == [1, 2, 1, 2], "panels of success, then of unsafe contacts"
    for _, _, (bars,) in drawn[1]:
        assert bars.get_segments()[0][:, 1] == pytest.approx([14, 24])
    assert len({tuple(line[0].get_color()) for line in drawn[1]}) == 2


def test_the_success_of_training_that_explores_does_not_stand_in_the_page(demo, tmp_path):
    shutil.copytree(demo / "pick", tmp_path / "pick")
    best = {"finished": True, "best": {"success": 0.546372819}, "machine": {"cores": 2}}
    (tmp_path / "pick" / "provenance.json").write_text(json.dumps(best))
    text = report.report(ReportConfig(run=str(tmp_path), output=None, video=False)).read_text()
    assert "0.546372819" not in text and "cores 2" in text


def test_the_split_is_told_and_spawns_only_where_episodes_have_them(demo, tmp_path):
    shutil.copytree(demo / "pick", tmp_path / "pick")
    drawn = read_table(tmp_path / "pick" / "eval" / "episodes.csv").assign(seen=None, split="validation")
    write_json(tmp_path / "pick" / "eval" / "summary.json", summarise(drawn, ["seen"], 500))
    (row,) = report.headline(run_folder.find_runs(tmp_path / "pick"))
    assert row["split"] == "validation" and "spawns" not in row


def test_totals_are_found_for_summaries_of_another_folder_and_without_a_split(demo):
    episodes = run_folder.find_runs(demo)[0].episodes
    groups = summarise(episodes.assign(policy="elsewhere", split="paper"), ["seen"], 500)["groups"]
    found = with_totals(groups, episodes)
    assert [(each["seen"], each["episodes"], each["split"]) for each in found] == [
        (False, 11, "paper"), (True, 10, "paper"), ("all", 21, "paper"),
    ]  # fmt: skip
    assert with_totals(groups, None) == groups and with_totals(groups[:1], episodes) == groups[:1]


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


def test_without_egl_the_page_names_the_packages(demo, monkeypatch):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)
    config = ReportConfig(run=str(demo), output=None, video=True)
    found, why = videos(run_folder.find_runs(demo), config)
    assert not found
    assert "libegl1 libegl-mesa0 libgl1-mesa-dri" in why


@pytest.fixture
def undrawn(monkeypatch):
    """Write a video as the length of each of its episodes, its speed, azimuth, begin and end; draw nothing."""
    monkeypatch.setattr(video, "frames", lambda take, *words: (len(take.path), words))
    monkeypatch.setattr(video, "beside", list)
    monkeypatch.setattr(video, "write_video", lambda file, episodes: file.write_text(repr(episodes)))


def test_a_failure_is_shown_before_a_success_or_the_episode_that_was_asked_for(demo, undrawn, monkeypatch):
    runs = run_folder.find_runs(demo)
    found, _ = videos(runs, ReportConfig(run=str(demo), output=None, video=True))
    assert [caption.split(";")[0] for _, caption in found] == [
        "cycle, episode 3, unsafe contact", "cycle, episode 0, success",
    ]  # fmt: skip
    monkeypatch.setattr(module, "LONGEST_S", 0.04)
    found, _ = videos(runs, ReportConfig(run=str(demo), output=None, video=True))
    assert all(caption.endswith(", real time, the last 0.04 s.") for _, caption in found)
    ((_, (_, _, begin_s, end_s)),) = ast.literal_eval((demo / "cycle" / "eval" / "failure.mp4").read_text())
    assert begin_s > 0.04 and end_s is None
    found, _ = videos(runs, ReportConfig(run=str(demo), output=None, video=True, episode=2, speed=0.5))
    assert [caption for _, caption in found] == ["cycle, episode 2, success; drawn from its joint angles, half speed."]
    assert "(0.5," in (demo / "cycle" / "eval" / "video.mp4").read_text()
    kept, _ = videos(runs, ReportConfig(run=str(demo), output=None, video=False))
    assert len(kept) == 2, "those of before"
    with pytest.raises(ConfigError, match="episode=20 is not recorded"):
        videos(runs, ReportConfig(run=str(demo), output=None, video=True, episode=20))
    for name in module.FILES.values():
        (demo / "cycle" / "eval" / name).unlink()


def test_the_first_and_the_last_level_are_drawn_beside_each_other_from_one_side(demo, tmp_path, undrawn, monkeypatch):
    folder = tmp_path / "pick"
    runs = levels_of(demo, folder)
    found, _ = videos(runs, ReportConfig(run=str(folder), output=None, video=True, episode=1))
    assert "episode 1 at level 1 (left: success) and at level 10 (right: success);" in found[0][1]
    (one, here), (other, there) = ast.literal_eval((folder / "eval" / "video.mp4").read_text())
    assert one == other and here == there
    monkeypatch.setattr(module, "LONGEST_S", 0.04)
    found, _ = videos(runs, ReportConfig(run=str(folder), output=None, video=True))
    assert found[0][1].endswith(", real time, the first 0.04 s.")
    for _, (_, _, begin_s, end_s) in ast.literal_eval((folder / "eval" / "video.mp4").read_text()):
        assert (begin_s, end_s) == (0.0, 0.04)


def test_pictures_beside_each_other_last_as_long_as_the_longest():
    short, long = (iter([np.full((2, 3, 3), k) for k in range(n)]) for n in (1, 3))
    pictures = list(video.beside([short, long]))
    assert [each.shape for each in pictures] == [(2, 6, 3)] * 3 and pictures[2][0, :, 0].tolist() == [0] * 3 + [2] * 3


@pytest.mark.parametrize("angle", np.arange(0, 360, 20))
def test_the_camera_sees_person_and_tool_beside_each_other(angle):
    x, y = 0.7 * np.cos(np.radians(angle)), 0.7 * np.sin(np.radians(angle))
    path = DataFrame({"human_x": [x] * 5, "human_y": y, "tcp_x": 0.0, "tcp_y": 0.0})
    view = np.radians(video.azimuth_deg(path))
    across, ahead = x * np.sin(view) - y * np.cos(view), x * np.cos(view) + y * np.sin(view)
    assert 0.5 < abs(across) < 1.1 and ahead > -0.2
    assert video.azimuth_deg(path.assign(human_x=50.0)) == video.ALONE_DEG


def test_an_episode_is_drawn_to_an_mp4(demo, tmp_path):
    run = run_folder.find_runs(demo)[0]
    (take,) = next(each.takes for each in Tape(run).recordings if each.episode == 0)
    try:
        file = video.write_video(tmp_path / "video.mp4", video.frames(replace(take, path=take.path[:12])))
        duration_s = take.clip.duration_s
        last = list(video.frames(take, begin_s=duration_s - 0.08))
        whole = list(video.frames(take))
        assert len(last) == 3 < len(whole) == round(duration_s * video.FRAMES_PER_S) + 1
        assert (last[2] == whole[-1]).all() and len(list(video.frames(take, end_s=0.08))) == 3
    except PicturesUnavailableError as error:
        pytest.skip(f"nothing can be drawn off screen here: {error}")
    data = file.read_bytes()
    assert data[4:8] == b"ftyp"
    assert len(data) > 2000


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("metrics.csv", "policy_steps,updates\n1,2\n"),
        ("provenance.json", '{"commit": '),
        ("eval/summary.json", "{}"),
        ("eval/summary.json", '{"groups": [{"task": "pick", "episodes": 1, "metrics": {}}]}'),
        (
            "eval/summary.json",
            '{"groups": [{"task": "", "policy": "", "human": "", "precision_m": [], "episodes": 1, "metrics": {}}]}',
        ),
        ("eval/episodes.csv", "episode\n1\n"),
        ("eval/episodes.csv", "episode,success,steps\n1,True,1e19\n"),
        ("eval/paths.csv", "episode,step\n0,1\n"),
        ("config.yaml", "a: [1"),
    ],
)
def test_a_damaged_file_is_named_in_one_line(tmp_path, name, text):
    folder = make_demo(tmp_path / "demo") / "pick"
    (folder / name).write_text(text)
    with pytest.raises(ConfigError, match=name) as error:
        report.report(ReportConfig(run=str(folder), output=None, video=False))
    assert "\n" not in str(error.value)
    assert not (folder / "report.html").exists()


def test_the_title_of_a_panel_of_checkpoints_says_what_its_table_has() -> None:
    table = DataFrame({"policy_steps": [1], "success": [0.5]})
    assert report._title("pick", table) == "pick\n"
    table = table.assign(split="validation", human="patrol", precision_m=0.1)
    assert report._title("pick", table) == "pick\nvalidation, human=patrol, 10 cm"
