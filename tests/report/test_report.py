"""A report is one small page that tells each run with its figures, and names what is missing or damaged."""

from __future__ import annotations

import base64
import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from hrl_comfort.analysis.episodes import terminations
from hrl_comfort.analysis.summary import summarise, with_totals
from hrl_comfort.config import ConfigError, ReportConfig
from hrl_comfort.files import run_folder
from hrl_comfort.files.atomic import write_json
from hrl_comfort.files.tables import read_table, records_of
from hrl_comfort.plots import training
from hrl_comfort.report import report
from hrl_comfort.report.texts import summary
from tests.report.demo import levels_of, make_demo, make_evaluation, make_training


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
