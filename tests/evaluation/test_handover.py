"""Handover diagnostics tell a chain that holds at its seams from one that does not."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from hrl_comfort.cli.main import main
from hrl_comfort.config import EVALUATION_EPISODES

REFERENCE = Path(__file__).resolve().parents[2] / "runs" / "reference"
POLICIES = [f"policies.{name}={REFERENCE / name}" for name in ("pick", "place", "return")]


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hrl_comfort.evaluation.handover.RECORDED_EPISODES", 30)
        output = tmp_path_factory.mktemp("handover")
        words = ["task=cycle", "meta_controller=nearest", *POLICIES, "episodes=12", f"output={output}"]
        assert main(["evaluate", "handover", *words]) == 0
    return output


def test_every_seam_is_measured_from_its_own_starts_the_policy_before_and_the_expert(folder: Path) -> None:
    rows = table(folder / "handover.csv")
    kinds = [(row["subtask"], row["start"]) for row in rows]
    assert kinds == [(name, kind) for name in ("place", "return") for kind in ("own", "previous", "expert")]
    assert all(row["episodes"] == "12" for row in rows)
    assert all(float(row["success"]) > 0.7 for row in rows if row["start"] != "expert")


def test_chains_get_no_more_successes_as_they_get_longer(folder: Path) -> None:
    shares = [float(row["success"]) for row in table(folder / "chain.csv")]
    assert len(shares) == 3 and shares == sorted(shares, reverse=True)


def test_observations_are_named_with_how_far_they_lie_from_those_of_training(folder: Path) -> None:
    rows = [row for row in table(folder / "seams.csv") if (row["subtask"], row["start"]) == ("place", "own")]
    assert {row["observation"] for row in rows} >= {"joint_angles", "tool", "goal_offset"}
    assert all(0 <= float(row["share_far"]) <= 1 for row in rows)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["task=pick", f"policy={REFERENCE / 'pick'}"], "meta_controller=none chains nothing"),
        (["task=cycle", "meta_controller=nearest", *POLICIES[:2]], "policies.return is not given"),
        (
            ["task=cycle", "meta_controller=nearest", *POLICIES, f"episodes={EVALUATION_EPISODES + 1}"],
            "episodes=",
        ),
    ],
)
def test_what_is_no_chain_gets_one_line(words: list[str], says: str, capsys, tmp_path: Path) -> None:
    assert main(["evaluate", "handover", *words, f"output={tmp_path / 'x'}"]) == 1
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1
    assert not (tmp_path / "x").exists()
