"""Handovers of several training seeds: success by start, its share of the own-start one, and chains."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from hrl_comfort.analysis.handover import CHAIN, SEAMS, summarise, table
from hrl_comfort.cli.main import main
from hrl_comfort.config import ConfigError


def handover(folder: Path, wins: dict[str, list[bool]], chain: list[float]) -> Path:
    folder.mkdir(parents=True)
    lines = ["subtask,start,episode,spawn_id,success"]
    for start, each in wins.items():
        lines += [f"place,{start},{i},{i % 3},{win}" for i, win in enumerate(each)]
    (folder / SEAMS).write_text("\n".join(lines) + "\n")
    lines = ["options,success,success_low,success_high"]
    lines += [f"{k},{share},0,1" for k, share in enumerate(chain, start=1)]
    (folder / CHAIN).write_text("\n".join(lines) + "\n")
    return folder


@pytest.fixture
def folders(tmp_path: Path) -> list[Path]:
    good, half = [True] * 6, [True, False] * 3
    return [
        handover(tmp_path / "seed0", {"own": good, "previous": half, "expert": good}, [1.0, 0.5]),
        handover(tmp_path / "seed1", {"own": good, "previous": good, "expert": half}, [1.0, 0.9]),
    ]


def test_success_is_pooled_over_seeds_and_told_as_a_share_of_the_own_starts(folders: list[Path]) -> None:
    found = summarise(folders)
    previous = found["seams"]["place"]["previous"]
    assert previous["mean"] == pytest.approx(0.75) and previous["of_own"]["mean"] == pytest.approx(0.75)
    shares = [0.5, 1.0]
    students = stats.t.interval(0.95, 1, np.mean(shares), stats.sem(shares))
    assert previous["of_own"]["ci95"] == pytest.approx(list(students))
    assert previous["ci95"] == [0, 1], "a share goes no farther"
    assert [at["success"] for at in found["chain"]] == pytest.approx([1.0, 0.7])
    assert found["chain"][1]["seeds"] == [0.5, 0.9]


def test_the_table_has_a_line_a_label_and_subtask(folders: list[Path]) -> None:
    lines = table({"before": summarise(folders[:1]), "after": summarise(folders[1:])}).splitlines()
    assert [line.split(" | ")[:2] for line in lines[2:]] == [["| before", "place"], ["| after", "place"]]
    assert lines[3].endswith("| 100.0, 90.0 |")


def test_a_folder_without_handovers_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"handover_episodes\.csv is not there or empty; kind=handover takes"):
        summarise([tmp_path])


def test_starts_of_other_episodes_are_refused(tmp_path: Path) -> None:
    wins = {"own": [True] * 3, "previous": [True] * 2, "expert": [True] * 3}
    with pytest.raises(ConfigError, match="place has not the same episodes from every start"):
        summarise([handover(tmp_path / "x", wins, [1.0])])


def test_the_figure_is_drawn_with_its_numbers(folders: list[Path], tmp_path: Path) -> None:
    output = tmp_path / "handover.png"
    words = [f"evaluations=[{folders[0]},{folders[1]}]", "labels=[before,after]", f"output={output}"]
    assert main(["figure", "kind=handover", *words]) == 0
    assert output.is_file() and set(json.loads(output.with_suffix(".json").read_text())) == {
        "before",
        "after",
    }
