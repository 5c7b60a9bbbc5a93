"""Figures of what controllers do."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from matplotlib.patches import Rectangle
from pandas import DataFrame, read_csv

from hrl_comfort.analysis.episodes import chain_lengths
from hrl_comfort.analysis.option_use import over_time, shares_by_kind, summarise, table, with_kinds
from hrl_comfort.cli.main import main
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, FigureConfig
from hrl_comfort.hierarchy.options import Cause
from hrl_comfort.plots.figure import figure
from hrl_comfort.plots.hierarchy import timeline
from hrl_comfort.plots.option_use import CAUSES, option_use
from hrl_comfort.plots.training import option_shares


def run(episode: int, option: str, termination: str, start: int = 0, end: int = 10) -> dict[str, object]:
    return {
        "episode": episode, "option": option, "attempt": 1, "start_step": start,
        "end_step": end, "termination": termination,
    }  # fmt: skip


OPTIONS = [
    run(0, "pick_1", "success"),
    run(0, "wait", "success"),
    run(0, "place", "preempted"),
    run(0, "place", "success"),
    run(1, "pick_2", "success"),
    run(1, "place", "failure"),
]
EPISODES = DataFrame({"episode": [0, 1, 2]})


def test_chain_lengths_count_what_takes_the_task_further() -> None:
    found = chain_lengths(EPISODES, DataFrame(OPTIONS))
    assert [(at["options"], at["success"]) for at in found] == [(1, 2 / 3), (2, 1 / 3)]
    assert all(at["ci95"][0] < at["success"] < at["ci95"][1] for at in found)


def test_an_object_that_is_picked_again_makes_no_chain_longer() -> None:
    again = [
        run(0, "pick_1", "success"), run(0, "place", "preempted"), run(0, "retreat", "success"),
        run(0, "pick_1", "success"), run(0, "place", "success"),
    ]  # fmt: skip
    assert [at["options"] for at in chain_lengths(EPISODES[:1], DataFrame(again))] == [1, 2]


def test_a_retreat_counts_where_it_takes_the_place_of_a_return_alone() -> None:
    names = ["pick_1", "retreat", "place_as_1", "retreat", "retreat", "pick_2_as_1"]
    found = chain_lengths(EPISODES[:1], DataFrame([run(0, name, "success") for name in names]))
    assert [at["options"] for at in found] == [1, 2, 3, 4]


@pytest.fixture(scope="module")
def evaluation(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cycle")
    experts = [f"policies.{name}=expert" for name in ("pick", "place", "return")]
    words = [
        "task=cycle",
        "meta_controller=nearest",
        "human=none",
        "episodes=3",
        *experts,
        f"output={folder}",
    ]
    assert main(["evaluate", *words]) == 0
    return folder


@pytest.mark.parametrize("kind", ["timeline", "chain", "options"])
def test_figures_of_options_are_drawn_from_an_evaluation(kind: str, evaluation: Path, tmp_path: Path) -> None:
    output = tmp_path / f"{kind}.png"
    config = compose("figure", [f"kind={kind}", f"evaluations=[{evaluation}]", f"output={output}"])
    assert isinstance(config, FigureConfig)
    figure(config)
    assert output.stat().st_size > 5000
    assert output.with_suffix(".json").exists() is (kind != "timeline")


def test_an_evaluation_without_options_or_episode_is_refused(evaluation: Path, tmp_path: Path) -> None:
    words = ["kind=timeline", f"evaluations=[{evaluation}]", f"output={tmp_path}/t.png", "episodes=[999]"]
    with pytest.raises(ConfigError, match="no episode 999"):
        figure(compose("figure", words))


def test_what_an_option_does_has_its_colour_in_every_timeline_and_only_what_is_drawn_is_named() -> None:
    def named(*options: str) -> dict[str, object]:
        rows = [*(run(0, option, "success") for option in options), run(1, "retreat", "success")]
        legend = timeline(DataFrame(rows), [0]).legends[0]
        shown = zip(legend.get_texts(), legend.legend_handles, strict=True)
        return {text.get_text(): bar.get_facecolor() for text, bar in shown if isinstance(bar, Rectangle)}

    few, many = named("pick_2", "return"), named("wait", "pick_1", "place", "return")
    assert list(few) == ["pick", "return"] and list(many) == ["pick", "place", "return", "wait"]
    assert few["return"] == many["return"] and len(set(many.values())) == 4


USED = with_kinds(
    DataFrame([
        {**run(0, "pick_2_as_6", "success", 0, 50), "cause": "done", "regret": 0.5},
        {**run(0, "hover", "preempted", 50, 100), "cause": "time limit", "regret": 0.0},
        {**run(1, "pick_1", "failure", 0, 200), "cause": "contact", "regret": 1.0},
    ])
)  # fmt: skip
"""Two episodes, of 2 s and of 4 s."""


def test_the_use_of_options_is_told_over_time_and_one_that_is_over_is_in_none() -> None:
    bounds, shares = over_time(USED)
    assert bounds[0] == 0 and bounds[-1] == 4 and list(shares) == ["pick", "hover"]
    assert np.allclose(shares["pick"], [1.0] * 10 + [0.5] * 30)
    assert np.allclose(shares["hover"], [0.0] * 10 + [0.5] * 10 + [0.0] * 20)


def test_the_use_of_options_has_shares_of_time_durations_causes_and_regrets() -> None:
    found = summarise(DataFrame({"episode": [0, 1]}), USED)
    pick = found["pick"]
    assert pick["runs"] == 2 and pick["time_share"]["mean"] == 0.75 and pick["duration_s"]["median"] == 2.5
    assert pick["causes"] == {"done": 1, "contact": 1} and pick["regret"] == 0.75
    lines = table({"mine": found}).splitlines()
    assert lines[0].endswith("| mean regret |") and lines[-1].endswith("| time limit 1 | 0.000 |")


def test_causes_and_options_are_drawn_beside_their_names() -> None:
    drawn = option_use({"mine": USED, "other": USED[:1]})
    options, causes = ([text.get_text() for text in legend.get_texts()] for legend in drawn.legends)
    assert options == ["pick", "hover"] and causes == ["done", "time limit", "contact"]
    assert [axis.get_xlabel() for axis in drawn.axes[3:]] == [
        "time (s)", "duration of a run (s)", "runs that end so (%)"
    ]  # fmt: skip
    assert [text.get_text() for text in drawn.axes[5].texts] == ["n = 1", "n = 0"]
    assert set(CAUSES) == {cause.value for cause in Cause}


def test_an_evaluation_of_before_causes_were_told_is_refused(evaluation: Path, tmp_path: Path) -> None:
    old = tmp_path / "old"
    shutil.copytree(evaluation, old)
    read_csv(old / "options.csv").drop(columns="cause").to_csv(old / "options.csv", index=False)
    with pytest.raises(ConfigError, match="old does not say why its options ended; evaluate again with --overwrite"):
        figure(compose("figure", ["kind=options", f"evaluations=[{old}]", f"output={tmp_path}/o.png"]))


def test_the_shares_of_options_over_a_training_are_drawn_by_kind() -> None:
    shares = {"share/wait": [0.5, 0.0], "share/pick_1": [0.25, 0.5], "share/pick_2_as_6": [0.25, 0.5]}
    log = DataFrame({"options": [100, 200], "episodes": [1, 1], **shares})
    found = shares_by_kind(log)
    assert {kind: share.tolist() for kind, share in found.items()} == {"pick": [0.5, 1.0], "wait": [0.5, 0.0]}
    assert list(found) == ["pick", "wait"] and not shares_by_kind(log[["options", "episodes"]])
    drawn = option_shares({"run": log})
    assert [text.get_text() for text in drawn.legends[0].get_texts()] == ["pick", "wait"]
