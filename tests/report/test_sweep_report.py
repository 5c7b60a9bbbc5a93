"""A sweep is reported whole: seeds pooled with an interval, and no job that is not finished left out."""

from __future__ import annotations

import csv
import html
import json
import re
import subprocess
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from pandas import DataFrame
from scipy import stats

from hrl_comfort.analysis.intervals import Clusters
from hrl_comfort.analysis.learning_curve import training_end
from hrl_comfort.analysis.sweeps import read_sweep
from hrl_comfort.cli.main import main
from hrl_comfort.config import ConfigError, ReportConfig
from hrl_comfort.files.sweep_record import Job, find_jobs
from hrl_comfort.plots import sweeps as sweep_figure
from hrl_comfort.report.report import report
from hrl_comfort.sweeps import job as sweep_job

RATES = ("0.0001", "0.001", "0.01")
SEEDS = ("0", "1", "2")
FAILED, KILLED, NOT_BEGUN = 7, 8, 5
ROWS = 50
WHY = "the critic's loss is nan at decision 12000"


def write(file: Path, rows: list[dict[str, float]]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("w", newline="") as out:
        writer = csv.DictWriter(out, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def make_training(folder: Path, best: float, rng: np.random.Generator, rows: int = ROWS) -> None:
    share = best * (1 - np.exp(-np.linspace(0, 5, ROWS)))[:rows]
    success = np.clip(share + rng.normal(0, 0.03, rows), 0, 1)
    columns = {
        "policy_steps": 1000 * np.arange(1, rows + 1),
        "episodes": 20 * np.arange(1, rows + 1),
        "success": success,
        "return": 10 * success - 3,
        "steps": 120 - 60 * success,
        "precision_m": np.full(rows, 0.1),
    }
    write(
        folder / "metrics.csv",
        [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)],
    )
    write(folder / "timing.csv", [{"policy_steps": 1000 * rows, "seconds": 6 * rows}])
    finished = rows == ROWS
    (folder / "provenance.json").write_text(json.dumps({"commit": "abc123", "finished": finished}))
    (folder / "config.yaml").write_text("task: {name: reach}\n")


def make_sweep(folder: Path) -> Path:
    rng = np.random.default_rng(0)
    (folder).mkdir()
    task = ["agent.learning_rate=0.0001,0.001,0.01", "train_seed=0,1,2", "task=reach"]
    (folder / "multirun.yaml").write_text(json.dumps({"hydra": {"overrides": {"task": task}}}))
    for k, (rate, seed) in enumerate((rate, seed) for rate in RATES for seed in SEEDS):
        if k == NOT_BEGUN:
            continue
        overrides = (f"agent.learning_rate={rate}", f"train_seed={seed}", "task=reach")
        state = {FAILED: "failed", KILLED: "running"}.get(k, "done")
        Job("train", overrides, state, WHY if k == FAILED else "").write(folder / str(k))
        if k != FAILED:
            best = {"0.0001": 0.5, "0.001": 0.95, "0.01": 0.3}[rate] + rng.normal(0, 0.04)
            make_training(folder / str(k), best, rng, 20 if k == KILLED else ROWS)
    return folder


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_sweep(tmp_path_factory.mktemp("runs") / "rates")


def reported(folder: Path) -> Path:
    return report(ReportConfig(run=str(folder), output=None, video=False))


def test_a_row_a_combination_counts_every_job_that_was_asked_for(sweep: Path) -> None:
    rows = {row.name: row for row in read_sweep(sweep).rows}
    assert list(rows) == [f"agent.learning_rate={rate}" for rate in RATES]
    counts = [list(row.counts.values()) for row in rows.values()]
    assert counts == [[3, 0, 0], [2, 1, 0], [1, 1, 1]]


def test_a_mean_is_of_the_end_of_the_finished_runs_with_students_interval(sweep: Path) -> None:
    row = read_sweep(sweep).rows[0]
    ends = []
    for entry in row.entries:
        with (sweep / entry.where / "metrics.csv").open() as file:
            ends.append(np.mean([float(line["success"]) for line in csv.DictReader(file)][-5:]))
    low, high = stats.t.interval(0.95, 2, np.mean(ends), stats.sem(ends))
    assert row.means["success"]["mean"] == pytest.approx(np.mean(ends))
    assert row.means["success"]["ci95"] == pytest.approx([max(low, 0), min(high, 1)])
    assert read_sweep(sweep).rows[2].means["success"]["ci95"] is None, "one run has no interval"


def test_the_report_writes_table_and_figure_beside_the_sweep_and_names_what_is_not_finished(
    sweep: Path,
) -> None:
    page = reported(sweep)
    assert page == sweep / "report.html"
    assert (sweep / "report.png").read_bytes()[:4] == b"\x89PNG"
    with (sweep / "report.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [line["agent.learning_rate"] for line in table] == list(RATES)
    assert float(table[1]["success_low"]) < float(table[1]["success_mean"]) <= float(table[1]["success_high"])
    html = page.read_text(encoding="utf-8")
    for text in (html.replace("&#39;", "'"), (sweep / "report.md").read_text(encoding="utf-8")):
        assert WHY in text
        assert "not begun" in text
        assert "running, or killed, 20000 policy steps logged" in text
    assert 'src="data:image/svg' in html
    assert resources.files("hrl_comfort.report").joinpath("report.css").read_text(encoding="utf-8") in html


def test_a_combination_of_any_length_and_signs_is_drawn(tmp_path: Path) -> None:
    folder = make_sweep(tmp_path / "sweep")
    Job("train", (f"agent.learning_rate=$_$\n{'x' * 200_000}", "no equals sign"), "done").write(folder / "0")
    assert reported(folder).with_suffix(".png").is_file()


def test_a_run_with_an_evaluation_of_a_sweep_is_no_sweep(tmp_path: Path) -> None:
    Job("evaluate", ("policy=run",), "done").write(tmp_path / "run" / "eval")
    assert find_jobs(tmp_path / "run")
    (tmp_path / "run" / "config.yaml").write_text("task: {name: reach}\n")
    assert not find_jobs(tmp_path / "run")


def test_runs_that_are_not_finished_are_drawn_thin_and_in_no_mean(sweep: Path) -> None:
    figure = sweep_figure.learning(read_sweep(sweep))
    assert figure is not None
    (axis,) = figure.axes
    thin = [line for line in axis.lines if line.get_linewidth() < 1 and len(line.get_xdata()) > 1]
    thick = [line for line in axis.lines if line.get_linewidth() > 1 and line.get_marker() != "x"]
    assert (len(thick), len(thin), len(axis.collections)) == (3, 1, 2), "a line each; bands where there are two"
    assert thin[0].get_xdata()[-1] == 20
    assert axis.get_xlabel() == "policy steps (thousands)" and "%" in axis.get_ylabel()
    (legend,) = figure.legends
    assert [text.get_text().split("(")[-1] for text in legend.get_texts()] == [
        "n = 3)", "n = 2)", "n = 1)", "not finished",
    ]  # fmt: skip


def test_what_was_evaluated_in_the_runs_has_columns_of_its_own(tmp_path: Path) -> None:
    sweep = make_sweep(tmp_path / "rates")
    for k, success in ((0, (1, 1)), (1, (1, 0)), (2, (0, 0))):
        rows = [{"episode": i, "success": s, "steps": 50 + 10 * s} for i, s in enumerate(success)]
        write(sweep / str(k) / "eval" / "episodes.csv", rows)
    means = read_sweep(sweep).rows[0].means
    assert means["eval_success"]["mean"] == pytest.approx(0.5)
    assert means["eval_steps"]["mean"] == 60, "over successes, and a run without any says nothing"
    assert means["eval_success"]["ci95"] == [0, 1]


def test_a_sweep_of_evaluations_is_reported_too(tmp_path: Path) -> None:
    for k, seen in enumerate((True, False)):
        folder = tmp_path / "sweep" / str(k)
        Job("evaluate", (f"human={'arc' if seen else 'still'}",), "done").write(folder)
        write(folder / "episodes.csv", [{"episode": i, "success": int(seen), "steps": 9} for i in range(4)])
        (folder / "summary.json").write_text('{"groups": []}')
    reported(tmp_path / "sweep")
    text = (tmp_path / "sweep" / "report.md").read_text(encoding="utf-8")
    assert "| arc | 1 | 0 | 0 | 100.0 |" in text
    assert "| still | 1 | 0 | 0 | 0.0 |" in text
    assert not (tmp_path / "sweep" / "report.png").exists()


def test_a_hierarchy_of_a_sweep_is_told_by_its_chain(tmp_path: Path) -> None:
    for k, won in enumerate((1, 0)):
        folder = tmp_path / "sweep" / str(k)
        Job("train hierarchy", (f"train_seed={k}",), "done" if won else "running").write(folder)
        (folder / "hierarchy.yaml").write_text("task: {name: pick}\n", encoding="utf-8")
        write(
            folder / "cycle" / "eval" / "episodes.csv", [{"episode": i, "success": won, "steps": 9} for i in range(4)]
        )
        said = {"commit": "abc123", "finished": bool(won), "wall_seconds": 120.0}
        (folder / "provenance.json").write_text(json.dumps(said), encoding="utf-8")
    (row,) = read_sweep(tmp_path / "sweep").rows
    assert row.counts == {"finished": 1, "unfinished": 1, "failed": 0}
    means = {name: row.means[name]["mean"] for name in ("eval_success", "minutes")}
    assert means == {"eval_success": 1.0, "minutes": 2.0}
    assert [sweep_job._score(tmp_path / "sweep" / str(k)) for k in range(2)] == [1.0, 0.0]


def make_controller(folder: Path, returns: float, finished: bool = True) -> None:
    rows = [
        {"options": 1000 * k, "updates": 0, "episodes": 50, "success": 1.0, "placed": 4.0}
        | {"return": returns * k / 10, "steps": 600 - 10 * k}
        for k in range(1, 11 if finished else 6)
    ]
    write(folder / "meta_controller_metrics.csv", rows)
    said = {"commit": "abc123", "finished": finished, "wall_seconds": 1800.0}
    (folder / "provenance.json").write_text(json.dumps(said))
    (folder / "config.yaml").write_text("task: {name: sort}\nmeta_controller_agent: {gamma: 0.998}\n")


def test_a_sweep_of_controllers_is_compared_by_return_against_options(tmp_path: Path) -> None:
    sweep = tmp_path / "sweep"
    for k, returns in enumerate((1.0, 2.0, 3.0)):
        Job("train meta_controller", (f"train_seed={k}",), "done" if k < 2 else "running").write(sweep / str(k))
        make_controller(sweep / str(k), returns, finished=k < 2)
    table = read_sweep(sweep)
    (row,) = table.rows
    assert row.counts == {"finished": 2, "unfinished": 1, "failed": 0}
    assert table.entries[2].why == "running, or killed, 5000 options logged"
    ends = {name: row.means[name]["mean"] for name in ("return", "placed", "steps", "minutes")}
    assert ends == pytest.approx({"return": 1.5, "placed": 4, "steps": 500, "minutes": 30})
    assert "precision_m" not in row.means
    figure = sweep_figure.learning(table)
    assert figure is not None
    (axis,) = figure.axes
    assert axis.get_xlabel() == "options (thousands)" and "return" in axis.get_ylabel()
    assert axis.lines[0].get_ydata()[-1] == pytest.approx(1.5)
    (band,) = axis.collections
    assert band.get_paths()[0].get_extents().y0 < -4, "a return is cut nowhere"
    page = reported(sweep).read_text(encoding="utf-8")
    assert "Mean return of training episodes" in page and "Training episodes that succeed" not in page


def test_jobs_of_several_verbs_in_one_folder_are_no_sweep(tmp_path: Path) -> None:
    for k, verb in enumerate(("train", "train meta_controller")):
        Job(verb, (f"train_seed={k}",), "done").write(tmp_path / str(k))
    make_training(tmp_path / "0", 0.9, np.random.default_rng(0))
    make_controller(tmp_path / "1", 0.9)
    with pytest.raises(ConfigError, match="holds jobs of train and of train meta_controller; give each"):
        read_sweep(tmp_path)


def test_a_training_that_took_no_number_of_seconds_is_named(tmp_path: Path) -> None:
    make_controller(tmp_path, 1.0)
    said = json.loads((tmp_path / "provenance.json").read_text())
    (tmp_path / "provenance.json").write_text(json.dumps({**said, "wall_seconds": None}))
    with pytest.raises(ConfigError, match=r"provenance\.json is damaged: wall_seconds=None: .* valid number"):
        reported(tmp_path)


def test_the_report_of_a_controllers_training_shows_its_curves(tmp_path: Path) -> None:
    make_controller(tmp_path / "meta_controller", 2.0)
    (tmp_path / "meta_controller" / "meta_controller.pt").touch()
    page = reported(tmp_path / "meta_controller").read_text(encoding="utf-8")
    assert "control steps of an episode, and mean return" in page
    assert "No learning curves" not in page and "precision in force" not in page
    assert "policies.meta_controller=" in page and "evaluate policy=" not in page, "it would be refused"


def test_the_command_that_compares_a_sweep_works_as_pasted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[list[str]] = []
    monkeypatch.setattr("hrl_comfort.sweeps.launcher.multirun", lambda *given: asked.append(given[2]))
    sweep = make_sweep(tmp_path / "my rates")
    page = reported(sweep).read_text(encoding="utf-8")
    (command,) = re.findall("<code>(hrl-comfort .*?)</code>", page)
    done = subprocess.run(["bash", "-c", f"printf '%s\\n' {html.unescape(command)}"], capture_output=True, text=True)
    assert main(done.stdout.splitlines()[1:]) == 0
    ((policies, split),) = asked
    assert str(sweep / "0") in policies and split == "split=validation"


def test_runs_beside_a_sweep_are_named(tmp_path: Path) -> None:
    sweep = make_sweep(tmp_path / "rates")
    make_training(sweep / "another", 0.5, np.random.default_rng(0))
    assert "not in the table: another" in reported(sweep).read_text(encoding="utf-8")


def test_a_folder_of_runs_that_holds_a_sweep_is_none(tmp_path: Path) -> None:
    make_training(tmp_path / "pick", 0.9, np.random.default_rng(0))
    make_sweep(tmp_path / "sweep")
    assert not find_jobs(tmp_path) and find_jobs(tmp_path / "sweep")


def test_jobs_come_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for k in (10, 9, 2):
        Job("train", (f"train_seed={k}",), "running").write(tmp_path / str(k))
    assert [path.name for path in find_jobs(tmp_path)] == ["2", "9", "10"]


@pytest.mark.parametrize("text", ["{", "{}", '{"verb": "train", "overrides": [], "state": "asleep"}'])
def test_a_damaged_record_is_named_in_one_line(tmp_path: Path, text: str) -> None:
    sweep = make_sweep(tmp_path / "rates")
    (sweep / "0" / "job.json").write_text(text)
    with pytest.raises(ConfigError, match=r"0/job\.json is damaged") as error:
        reported(sweep)
    assert "\n" not in str(error.value)


def test_the_end_of_a_training_weighs_rows_by_their_episodes_and_leaves_out_empty_ones() -> None:
    metrics = {
        "policy_steps": np.array([10.0, 95.0, 98.0, 100.0]),
        "episodes": np.array([5.0, 6.0, 9.0, 9.0]),
        "success": np.array([0.0, 1.0, 0.5, np.nan]),
        "return": np.full(4, np.nan),
        "steps": np.array([1.0, 2.0, 2.0, np.nan]),
        "precision_m": np.array([0.3, 0.2, 0.2, 0.1]),
    }
    assert training_end(DataFrame(metrics)) == {"precision_m": 0.1, "success": pytest.approx(0.625), "steps": 2.0}


def test_the_interval_over_seeds_is_students_and_needs_two() -> None:
    assert Clusters.of_runs(1).estimate(np.array([0.5]))["ci95"] is None
    assert Clusters.of_runs(2).estimate(np.array([0.0, 1.0]))["ci95"] == pytest.approx(
        [0.5 - 12.706 * 0.5, 0.5 + 12.706 * 0.5], abs=1e-3
    )
