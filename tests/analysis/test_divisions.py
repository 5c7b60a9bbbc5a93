"""Divisions of a task are compared on the same episodes, and with what they took to train."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hrl_comfort.analysis.comparison import divisions, table, training_cost
from hrl_comfort.cli.main import main
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError
from hrl_comfort.files.run_config import save_config
from hrl_comfort.files.run_folder import Run
from hrl_comfort.files.tables import records_of


def training(folder: Path, policy_steps: int, initial: Path | None = None, agent: str = "sac") -> str:
    folder.mkdir(parents=True)
    words = ["task=pick", f"agent={agent}", f"output={folder}", *([f"initial_policy={initial}"] if initial else [])]
    save_config(compose("train", words), folder / "config.yaml")
    about = {
        "finished": True,
        "commit": "",
        "policy_steps": policy_steps,
        "wall_seconds": 0.06 * policy_steps,
    }
    (folder / "provenance.json").write_text(json.dumps(about))
    return str(folder)


def evaluation(policies: dict[str, str], steps: list[str], success: list[str] | None = None, **config) -> Run:
    wins = success or ["True"] * len(steps)
    episodes = [
        {
            "train_seed": "0", "episode": str(i), "spawn_id": str(i), "success": win, "steps": each,
            "human_distance_mean_m": "1.0", "contact": "True" if win == "False" else "False",
            "unsafe_contact": "True" if win == "False" else "False",
        }
        for i, (each, win) in enumerate(zip(steps, wins, strict=True))
    ]  # fmt: skip
    return Run("run", Path("run"), config={"policies": policies, **config}, episodes=records_of(episodes, "episodes"))


def test_what_a_division_took_is_the_sum_over_its_policies_and_those_they_were_begun_from(tmp_path) -> None:
    first = Path(training(tmp_path / "first", 1000))
    pick, back = training(tmp_path / "pick", 500, first), training(tmp_path / "return", 200, first)
    took = training_cost(evaluation({"pick": pick, "return": back}, ["1"]))
    assert took == {"networks": 2, "policy_steps": 1700, "minutes": pytest.approx(1.7)}


def test_skills_that_go_on_together_took_what_each_of_them_took_before(tmp_path) -> None:
    for name, policy_steps in (("pick", 500), ("place", 200), ("return", 100)):
        training(tmp_path / "chain" / name, policy_steps)
    whole = training(tmp_path / "whole", 1000, tmp_path / "chain", "end_to_end")
    assert training_cost(evaluation({"cycle": whole}, ["1"]))["policy_steps"] == 1800


def test_a_training_that_is_not_finished_is_refused(tmp_path) -> None:
    folder = Path(training(tmp_path / "pick", 100))
    about = json.loads((folder / "provenance.json").read_text())
    (folder / "provenance.json").write_text(json.dumps({**about, "finished": False}))
    with pytest.raises(ConfigError, match="pick is not finished"):
        training_cost(evaluation({"pick": str(folder)}, ["1"]))


def test_a_policy_that_was_not_trained_is_refused() -> None:
    with pytest.raises(ConfigError, match="policy='expert' is not a run folder"):
        training_cost(evaluation({"pick": "expert"}, ["1"]))


def test_steps_are_compared_where_both_divisions_succeed(tmp_path) -> None:
    policies = {"cycle": training(tmp_path / "cycle", 100)}
    good = evaluation(policies, ["100", "120", "90"])
    worse = evaluation(policies, ["150", "130", "20"], ["True", "True", "False"])
    found = divisions({"a": [good], "b": [worse]})
    assert found["differences"]["a - b"]["steps"]["mean"] == pytest.approx(-30)
    assert found["differences"]["a - b"]["success"]["mean"] == pytest.approx(1 / 3)
    assert found["divisions"]["b"]["steps"]["mean"] == pytest.approx(140)
    assert found["divisions"]["b"]["contact"]["mean"] == pytest.approx(1 / 3)
    lines = table(found).splitlines()
    assert [line.split(" | ")[0] for line in lines] == ["| ", "| ---", "| a", "| b", "| a - b"]
    assert "| 1 | 100 | 0 |" in lines[2]


def test_divisions_beside_other_people_are_not_compared(tmp_path) -> None:
    policies = {"cycle": training(tmp_path / "cycle", 100)}
    groups = {name: [evaluation(policies, ["1"], human={"motion": name})] for name in ("arc", "still")}
    with pytest.raises(ConfigError, match="differ in human; compare like with like"):
        divisions(groups)


def test_the_figure_is_drawn_from_evaluations(tmp_path: Path) -> None:
    parts = {name: training(tmp_path / name, 10) for name in ("cycle", "pick_place", "return")}
    for folder, names in (("one", ["cycle"]), ("two", ["pick_place", "return"])):
        words = [
            "task=cycle",
            "meta_controller=nearest",
            f"division={folder}",
            "episodes=2",
            "human=none",
        ]  # no distance
        words += [f"policies.{name}=expert" for name in names]
        assert main(["evaluate", *words, f"output={tmp_path / 'eval' / folder}"]) == 0
        file = tmp_path / "eval" / folder / "config.yaml"
        text = file.read_text()
        for name in names:
            text = text.replace(f"{name}: expert", f"{name}: {parts[name]}")
        file.write_text(text)
    output = tmp_path / "divisions.png"
    evaluations = f"evaluations=[{tmp_path}/eval/one,{tmp_path}/eval/two]"
    words = ["kind=divisions", evaluations, "labels=[one,two]", f"output={output}"]
    assert main(["figure", *words]) == 0
    assert output.is_file() and set(json.loads(output.with_suffix(".json").read_text())) == {
        "divisions",
        "differences",
    }
