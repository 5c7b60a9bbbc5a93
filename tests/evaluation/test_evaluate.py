"""Evaluation: what it writes, and that it is the same for every policy compared."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import VALIDATION_SEED, ConfigError, EvaluateConfig
from hrl_comfort.config.overrides import override
from hrl_comfort.evaluation.checkpoints import checkpoints_of
from hrl_comfort.evaluation.evaluate import evaluate
from hrl_comfort.evaluation.rollout import path_columns
from hrl_comfort.files.provenance import policy_steps, step_path
from hrl_comfort.files.run_folder import Recorded, read_run, recorded


def run(tmp_path: Path, *overrides: str) -> Path:
    config = compose("evaluate", ["task=pick", "policy=random", "episodes=6", f"output='{tmp_path}'", *overrides])
    assert isinstance(config, EvaluateConfig)
    return evaluate(config)


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


CONTRACT = [
    "task",
    "policy",
    "train_seed",
    "episode_seed",
    "episode",
    "object",
    "spawn_id",
    "motion_id",
    "seen",
    "comfort_level",
    "human",
    "precision_m",
    "success",
    "steps",
    "policy_steps",
    "return",
    "human_distance_mean_m",
    "human_distance_min_m",
    "contact",
    "other_collision",
]


def test_episodes_csv_has_the_contracts_columns_and_a_row_an_episode(tmp_path: Path) -> None:
    rows = table(run(tmp_path) / "episodes.csv")
    assert set(CONTRACT) <= set(rows[0])
    assert [int(row["episode"]) for row in rows] == list(range(6))
    assert [row["seen"] for row in rows] == ["True", "False"] * 3
    assert all(row["train_seed"] == "" for row in rows)


def test_a_person_of_the_split_rates_whatever_gives_the_level(tmp_path: Path) -> None:
    levels = {"none": [], "fixed": ["comfort.level=3"], "fitted": []}
    found = {}
    for source, extra in levels.items():
        comfort = [] if source == "none" else ["comfort=conditioned", f"comfort.source={source}", *extra]
        found[source] = table(run(tmp_path / source, *comfort) / "episodes.csv")
    persons = {source: [int(row["person_id"]) for row in rows] for source, rows in found.items()}
    assert persons["none"] == persons["fixed"] == persons["fitted"]
    assert len(set(persons["none"])) > 3 and all(600 <= person < 800 for person in persons["none"])
    for rows in found.values():
        assert all(1 <= float(row["person_rating_mean"]) <= 7 for row in rows)


def test_a_level_that_a_person_s_rating_gives_follows_it(tmp_path: Path) -> None:
    rows = table(run(tmp_path, "comfort=conditioned", "comfort.source=fitted") / "episodes.csv")
    for row in rows:
        told = 1 + 9 * (float(row["person_rating_mean"]) - 1) / 6
        assert float(row["comfort_level_mean"]) == pytest.approx(told, abs=1.0)


def test_nobody_rates_where_nobody_is(tmp_path: Path) -> None:
    rows = table(run(tmp_path, "human=none", "comfort=conditioned", "comfort.source=fitted") / "episodes.csv")
    assert all(row["person_id"] == row["person_rating_mean"] == "" for row in rows)
    assert all(1 <= float(row["comfort_level_mean"]) <= 10 for row in rows)


def test_summary_has_one_group_a_seen_and_unseen(tmp_path: Path) -> None:
    summary = json.loads((run(tmp_path, "group_by=[seen]") / "summary.json").read_text(encoding="utf-8"))
    assert [(group["seen"], group["episodes"]) for group in summary["groups"]] == [(True, 3), (False, 3)]
    metrics = summary["groups"][0]["metrics"]
    assert 0 <= metrics["success"]["mean"] <= 1
    low, high = metrics["return"]["ci95"]
    assert low <= metrics["return"]["mean"] <= high


def test_evaluating_twice_gives_the_same_bytes(tmp_path: Path) -> None:
    first = (run(tmp_path / "a") / "episodes.csv").read_bytes()
    assert first == (run(tmp_path / "b") / "episodes.csv").read_bytes()


def test_an_evaluation_prints_its_table_and_folder_and_warns_of_an_earlier_one(tmp_path: Path, capsys) -> None:
    run(tmp_path, "levels=[1,10]")
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in lines[-3:-1]] == [["1", "paper"], ["10", "paper"]]
    assert lines[-1] == str(tmp_path)
    with pytest.warns(UserWarning, match="holds an earlier evaluation"):
        run(tmp_path)


def test_human_motion_is_the_same_whatever_the_policy_does(tmp_path: Path) -> None:
    human = []
    for index, limit in enumerate((20, 30)):
        folder = run(
            tmp_path / str(index),
            "record=true",
            f"episode_seed={1000000 + index}",
            f"task.max_episode_steps={limit}",
        )
        rows = [row for row in table(folder / "paths.csv") if int(row["step"]) <= 10]
        human.append({(r["episode"], r["step"]): (r["human_x"], r["human_y"]) for r in rows})
    common = human[0].keys() & human[1].keys()
    assert len(common) > 30
    assert all(human[0][key] == human[1][key] for key in common)


def test_recorded_paths_hold_every_control_step_once(tmp_path: Path) -> None:
    folder = run(tmp_path, "record=true", "task.max_episode_steps=23")
    rows, episodes = table(folder / "paths.csv"), table(folder / "episodes.csv")
    assert list(rows[0]) == path_columns(19)
    for episode in episodes:
        steps = sorted(int(row["step"]) for row in rows if row["episode"] == episode["episode"])
        assert steps == list(range(int(episode["steps"]) + 1))
        distances = [
            float(row["human_distance_m"])
            for row in rows
            if row["episode"] == episode["episode"] and int(row["step"]) > 0
        ]
        assert np.mean(distances) == pytest.approx(float(episode["human_distance_mean_m"]), abs=2e-6)
        assert min(distances) == pytest.approx(float(episode["human_distance_min_m"]), abs=2e-6)


def told(every: list[Recorded]) -> list[tuple[int, int | None]]:
    return [(each.episode, each.level) for each in every]


def test_recorded_paths_tell_levels_apart(tmp_path: Path) -> None:
    words = ("comfort=conditioned", "levels=[2,9]", "record=true", "task.max_episode_steps=13", "episodes=2")
    found = read_run(run(tmp_path, *words))
    assert told(recorded(found)) == [(0, 2), (1, 2), (0, 9), (1, 9)]
    for each in recorded(found):
        assert (each.row["episode"], each.row["comfort_level"]) == (each.episode, each.level)
        assert each.path["step"].tolist() == list(range(int(each.row["steps"]) + 1))
        assert set(each.path["level"]) == {each.level}
    assert told(recorded(found, count=1)) == [(0, 2)]
    assert told(recorded(found, episodes=(1,))) == [(1, 2), (1, 9)]


def test_recorded_levels_are_those_in_force_and_empty_without_one(tmp_path: Path) -> None:
    schedule = ("comfort.source=schedule", "comfort.schedule_s=[0,0.2]", "comfort.schedule_levels=[9,2]")
    words = ("record=true", "task.max_episode_steps=20", "episodes=2")
    found = read_run(run(tmp_path / "jump", "comfort=conditioned", *schedule, *words))
    first, *_ = recorded(found)
    assert told([first]) == [(0, 9)]
    assert first.path["level"][:11].tolist() == [9.0] * 11
    assert set(first.path["level"][11:]) <= {2.0}
    assert first.row["episode"] == 0
    none = read_run(run(tmp_path / "none", *words))
    assert told(recorded(none)) == [(0, None), (1, None)]
    assert {row["level"] for row in table(tmp_path / "none" / "paths.csv")} == {""}


def test_no_human_leaves_distances_empty_not_zero(tmp_path: Path) -> None:
    rows = table(run(tmp_path, "human=none") / "episodes.csv")
    assert {row["human_distance_mean_m"] for row in rows} == {""}


def test_chain_of_random_policies_writes_option_runs(tmp_path: Path) -> None:
    config = compose(
        "evaluate",
        [
            "task=cycle",
            "meta_controller=nearest",
            "meta_controller.time_limit_steps=40",
            "episodes=4",
            f"output='{tmp_path}'",
        ]
        + [f"policies.{name}=random" for name in ("pick", "place", "return")],
    )
    assert isinstance(config, EvaluateConfig)
    folder = evaluate(config)
    runs = table(folder / "options.csv")
    assert {row["episode"] for row in runs} == {"0", "1", "2", "3"}
    assert {row["termination"] for row in runs} <= {"success", "failure", "preempted"}
    episodes = table(folder / "episodes.csv")
    for episode in episodes:
        last = max(int(r["end_step"]) for r in runs if r["episode"] == episode["episode"])
        assert last == int(episode["steps"])


def test_chain_names_the_policy_that_is_missing(tmp_path: Path) -> None:
    config = compose(
        "evaluate", ["task=cycle", "meta_controller=nearest", f"output='{tmp_path}'", "policies.pick=random"]
    )
    assert isinstance(config, EvaluateConfig)
    with pytest.raises(ConfigError, match=r"policies\.place is not given"):
        evaluate(config)


def test_validation_episodes_are_drawn_as_in_training_and_the_same_at_every_level(tmp_path: Path) -> None:
    folder = run(tmp_path, "split=validation", "comfort=conditioned", "levels=[1,10]", "record=true")
    rows = table(folder / "episodes.csv")
    assert [int(row["episode_seed"]) for row in rows] == 2 * list(range(VALIDATION_SEED, VALIDATION_SEED + 6))
    assert {(row["split"], row["seen"]) for row in rows} == {("validation", "")}
    starts = [row for row in table(folder / "paths.csv") if row["step"] == "0"]
    people = [(row["human_x"], row["human_y"]) for row in starts]
    assert people[:6] == people[6:] and len(set(people)) == 6
    held_out = compose("evaluate").human.held_out
    assert not {row["spawn_id"] for row in rows} & set(map(str, held_out))
    groups = json.loads((folder / "summary.json").read_text(encoding="utf-8"))["groups"]
    assert [(group["split"], group["comfort_level"]) for group in groups] == [("validation", 1), ("validation", 10)]


def test_a_validation_episode_is_the_same_however_many_are_run(tmp_path: Path) -> None:
    words = ("split=validation", "policy=expert")
    whole = table(run(tmp_path / "a", *words) / "episodes.csv")
    part = table(run(tmp_path / "b", *words, "episodes=2", f"episode_seed={VALIDATION_SEED + 3}") / "episodes.csv")
    fresh = [{**row, "episode": ""} for row in part]
    assert fresh == [{**row, "episode": ""} for row in whole[3:5]]


@pytest.mark.parametrize("wrong", ["split=spare", "episode_seed=1000000", "episodes=10001"])
def test_validation_keeps_to_its_own_seeds(tmp_path: Path, wrong: str) -> None:
    with pytest.raises(ConfigError, match=wrong.split("=")[0]):
        run(tmp_path, "split=validation", wrong)


def test_more_episodes_than_the_set_holds_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"episodes=1001 is outside its range \[1, 1000\]"):
        run(tmp_path, "episodes=1001")


@pytest.mark.parametrize("wrong", ["policy=/no/such", "group_by=[no]", "comfort.source=file"])
def test_an_evaluation_that_is_refused_leaves_no_folder(tmp_path: Path, wrong: str) -> None:
    words = ["comfort.file=/no/such.csv"] if "file" in wrong else []
    with pytest.raises(ConfigError):
        run(tmp_path / "new" / "eval", wrong, *words)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("words", [[], ["checkpoints=all"]])
def test_a_folder_that_cannot_be_written_is_found_out_before_the_work(
    tmp_path: Path, words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hrl_comfort.evaluation.evaluate.rollout", None)
    monkeypatch.setattr("hrl_comfort.evaluation.checkpoints.rollout", None)
    (tmp_path / "file").touch()
    (tmp_path / "run" / "checkpoints").mkdir(parents=True)
    (tmp_path / "run" / "checkpoints" / "step_000000001.pt").touch()
    with pytest.raises(ConfigError, match=rf"output='{tmp_path}/file/eval.*{tmp_path}/file: Not a directory"):
        run(tmp_path / "file" / "eval", f"policy='{tmp_path}/run'", *words)


def test_checkpoints_of_a_chain_are_taken_at_equal_fractions_of_training(tmp_path: Path) -> None:
    kept = {"pick": (10, 20), "place": (25, 50, 75, 100), "return": ()}
    for part, steps in kept.items():
        (tmp_path / part / "checkpoints").mkdir(parents=True)
        for at in steps:
            step_path(tmp_path / part / "checkpoints", at).touch()
    words = [override(f"policies.{part}", tmp_path / part) for part in kept]
    config = compose("evaluate", ["task=cycle", "meta_controller=nearest", "checkpoints=all", *words])
    assert isinstance(config, EvaluateConfig)
    found = [{part: policy_steps(file) for part, file in each.items()} for each in checkpoints_of(config)]
    assert [each["place"] for each in found] == [25, 50, 75, 100] and "return" not in found[0]
    assert [each["pick"] for each in found] == [10, 10, 10, 20]
    config = compose("evaluate", [override("policy", tmp_path / "pick"), "checkpoints=all", "levels=[1,10]"])
    assert isinstance(config, EvaluateConfig)
    assert [policy_steps(each["policy"]) for each in checkpoints_of(config)] == [10, 20]


def test_all_checkpoints_of_a_folder_without_any_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"holds no step_\*\.pt"):
        run(tmp_path, "checkpoints=all")


def test_behind_a_shield_its_share_and_stops_are_recorded_and_empty_without(tmp_path: Path) -> None:
    words = ("record=true", "human=approach", "task.max_episode_steps=60")
    shielded = run(tmp_path / "a", *words, "robot.rating=collaborative", "safety=ssm")
    paths = table(shielded / "paths.csv")
    for episode in table(shielded / "episodes.csv"):
        mine = [row for row in paths if row["episode"] == episode["episode"]]
        mean = sum(float(row["shield_share"]) for row in mine[1:]) / int(episode["steps"])
        assert float(episode["shield_share_mean"]) == pytest.approx(mean, abs=1e-5) and 0 < mean <= 1
        assert episode["protective_stops"] == mine[-1]["protective_stops"]
    bare = table(run(tmp_path / "b", *words) / "episodes.csv")
    assert {(row["shield_share_mean"], row["protective_stops"]) for row in bare} == {("", "")}
