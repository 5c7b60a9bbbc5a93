import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import stats

from hrl_comfort.analysis import comfort
from hrl_comfort.analysis.tables import levels
from hrl_comfort.comfort.adapt import max_episode_steps
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError
from hrl_comfort.files.run_folder import Run
from hrl_comfort.files.tables import records_of

LIMIT = 100


def row(level: int, episode: int, **changes: object) -> dict[str, str]:
    cells: dict[str, object] = {
        "task": "pick_place",
        "precision_m": 0.3,
        "train_seed": 0,
        "human": "random_walk",
        "episode_seed": 1_000_000 + episode,
        "episode": episode,
        "spawn_id": episode % 3,
        "seen": episode % 2 == 0,
        "comfort_level": level,
        "success": True,
        "steps": 50,
        "human_distance_mean_m": 1.0,
        "contact": False,
        "unsafe_contact": False,
        "other_collision": "none",
        "human_distance_by_path_m": 1.0,
        "tool_path_m": 2.0,
        "waiting_share": 0.1,
        "joint_increment_mean_deg": 1.5,
    }
    return {name: str(value) for name, value in {**cells, **changes}.items()}


def evaluation(rows: list[dict[str, str]], limit: int = LIMIT, **config: object) -> Run:
    task = {"max_episode_steps": limit}
    return Run("run", Path("run"), config={"task": task, **config}, episodes=records_of(rows, "episodes"))


def data(rows: list[dict[str, str]]) -> comfort.Paired:
    return comfort.paired([evaluation(rows)])


def two_levels() -> comfort.Paired:
    """Three episodes: both levels succeed, level 10 fails, level 1 fails."""
    return data(
        [
            row(1, 0, steps=60, human_distance_mean_m=1.0),
            row(1, 1, steps=70, human_distance_mean_m=1.2),
            row(1, 2, steps=10, human_distance_mean_m=0.2, success=False, contact=True,
                unsafe_contact=True),
            row(10, 0, steps=45, human_distance_mean_m=0.8),
            row(10, 1, steps=20, human_distance_mean_m=0.3, success=False, contact=True,
                unsafe_contact=False),
            row(10, 2, steps=55, human_distance_mean_m=0.6),
        ]
    )  # fmt: skip


def test_a_pair_is_an_episode_that_succeeds_at_both_levels():
    found = comfort.compare(two_levels(), 1, 10)["pairs"]
    assert found["human_distance_mean_m"]["percent"] == pytest.approx(-20)
    assert found["steps"]["percent"] == pytest.approx(-25)
    assert found["steps"]["episodes"] == 1


def test_over_all_a_failure_takes_the_time_limit_and_its_distance_is_as_measured():
    found = comfort.compare(two_levels(), 1, 10)["all"]
    assert found["steps"]["from"] == pytest.approx((60 + 70 + LIMIT) / 3)
    assert found["steps"]["to"] == pytest.approx((45 + LIMIT + 55) / 3)
    assert found["human_distance_mean_m"]["from"] == pytest.approx((1.0 + 1.2 + 0.2) / 3)
    assert found["human_distance_mean_m"]["percent"] == pytest.approx(100 * (1.7 / 2.4 - 1))


@pytest.mark.parametrize("name", ["task", "precision_m", "spawn_id", "object"])
def test_only_like_is_compared(name):
    with pytest.raises(ConfigError, match=rf"{name} is '1(\.0)?' and '2(\.0)?'"):
        data([row(1, 0, **{name: 1}), row(10, 0, **{name: 2})])


def test_series_are_compared_over_entries_that_all_of_them_master():
    first = data([row(1, e, success=e != 0) for e in range(4)])
    second = data([row(1, e, train_seed=seed, success=e != seed) for e in range(4) for seed in (1, 2)])
    found = comfort.common({"first": first, "second": second})
    assert {label: sorted(each.entry) for label, each in found.items()} == {
        "first": ["random_walk/1000003/3"],
        "second": ["random_walk/1000003/3"] * 2,
    }
    with pytest.raises(ConfigError, match="no episode succeeds at every level of all of a, b"):
        comfort.common({"a": data([row(1, 0)]), "b": data([row(1, 0, success=False)])})


def test_each_evaluation_brings_its_own_time_limit():
    runs = [evaluation([row(level, 0, success=False)], limit) for level, limit in ((1, 100), (10, 250))]
    found = comfort.compare(comfort.paired(runs), 1, 10)["all"]["steps"]
    assert (found["from"], found["to"]) == (100, 250)


def test_a_time_limit_that_grows_as_the_level_falls_is_that_of_the_level():
    rows = [row(level, 0, success=False) for level in (1, 10)]
    config = compose("evaluate", ["comfort=conditioned", "comfort.beta=1"]).comfort
    run = evaluation(rows, 203, comfort=asdict(config))
    found = comfort.compare(comfort.paired([run]), 1, 10)["all"]["steps"]
    assert (found["from"], found["to"]) == tuple(max_episode_steps(torch.tensor([1.0, 10.0]), 203, config).tolist())


def test_rates_are_over_all_episodes_and_tell_a_moving_robot_from_a_still_one():
    at = comfort.summarise(two_levels())["spawns"]["all"]["levels"]
    rates = [{name: value["mean"] for name, value in level["rates"].items()} for level in at]
    third = pytest.approx(1 / 3)
    assert rates[0] == {
        "success": pytest.approx(2 / 3), "unsafe_contact": third, "contact": third,
        "other_collision": 0,
    }  # fmt: skip
    assert (rates[1]["unsafe_contact"], rates[1]["contact"]) == (0, third)


def test_a_rate_without_a_case_has_no_interval():
    at = comfort.summarise(two_levels())["spawns"]["all"]["levels"][0]
    assert at["rates"]["other_collision"] == {"mean": 0, "ci95": None, "episodes": 3}


def test_seen_and_unseen_spawns_are_told_apart():
    found = comfort.summarise(two_levels())["spawns"]
    assert {name: part["entries"] for name, part in found.items()} == {"all": 3, "seen": 2, "unseen": 1}
    assert found["unseen"]["levels"][0]["all"]["steps"]["mean"] == 70


def test_levels_of_several_folders_pair_by_training_seed_and_episode():
    runs = [evaluation([row(level, e, train_seed=s) for e in range(3)]) for level in (1, 10) for s in (0, 1)]
    found = comfort.paired(runs)
    assert found.levels == (1, 10)
    assert len(found.entries) == 6 and found.seeds == [0, 1]
    assert comfort.compare(found, 1, 10)["pairs"]["steps"]["episodes"] == 6


def test_an_episode_that_one_level_lacks_is_no_pair():
    found = data([row(1, 0, steps=40), row(1, 1, steps=80), row(10, 0, steps=20)])
    for over in comfort.OVER:
        assert comfort.compare(found, 1, 10)[over]["steps"]["percent"] == pytest.approx(-50)
    assert comfort.of_spawns(found)["levels"][0]["all"]["steps"]["mean"] == 60


def test_missing_stays_missing():
    rows = [row(level, e, human_distance_mean_m="") for level in (1, 10) for e in range(3)]
    found = comfort.summarise(data(rows))
    part = found["spawns"]["all"]
    assert "human_distance_mean_m" not in part["levels"][0]["pairs"]
    assert "human_distance_mean_m" not in part["first_to_last"]["all"]
    assert part["neighbours"][0]["pairs"]["distance"] is None
    assert part["monotone"]["pairs"] is False
    json.dumps(found, allow_nan=False)
    assert "–" in levels(found)


def test_one_missing_distance_leaves_the_others():
    rows = [row(level, e) for level in (1, 10) for e in range(3)]
    rows[0]["human_distance_mean_m"] = ""
    assert comfort.compare(data(rows), 1, 10)["pairs"]["human_distance_mean_m"]["episodes"] == 2


def test_over_several_seeds_the_interval_of_a_change_is_students_over_their_changes():
    after = {0: 40, 1: 44, 2: 47}
    rows = [row(1, e, train_seed=s, steps=50) for s in after for e in range(6)]
    rows += [row(10, e, train_seed=s, steps=steps) for s, steps in after.items() for e in range(6)]
    found = comfort.compare(data(rows), 1, 10)["pairs"]["steps"]
    changes = [100 * (steps / 50 - 1) for steps in after.values()]
    assert found["percent"] == pytest.approx(np.mean(changes))
    assert found["ci95"] == pytest.approx(list(stats.t.interval(0.95, 2, np.mean(changes), stats.sem(changes))))


@pytest.mark.parametrize(
    ("percent", "ci95", "says"),
    [
        (-1.0, [-2.0, 1.0], "falls"),
        (0.5, [-1.0, 2.0], "within"),
        (0.5, [0.1, 2.0], "rises"),
        (0.5, None, "rises"),
    ],
)
def test_the_verdict_on_neighbouring_levels(percent, ci95, says):
    assert comfort.verdict({"percent": percent, "ci95": ci95}) == says


def test_monotone_means_that_no_neighbour_rises():
    def at(distances):
        rows = [
            row(level, e, human_distance_mean_m=d + 0.001 * e) for level, d in enumerate(distances, 1) for e in range(6)
        ]
        return comfort.summarise(data(rows))["spawns"]["all"]

    falling, bent = at([1.0, 0.9, 0.8]), at([1.0, 0.8, 0.9])
    assert falling["monotone"] == {"pairs": True, "all": True}
    assert bent["monotone"] == {"pairs": False, "all": False}
    assert [step["pairs"]["distance"] for step in bent["neighbours"]] == ["falls", "rises"]


def test_the_table_has_a_line_a_level_and_the_change():
    lines = levels(comfort.summarise(two_levels())).splitlines()
    assert len(lines) == 2 + 2 + 1
    assert len({line.count("|") for line in lines}) == 1
    assert "-20.0" in lines[-1]


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ([row(1, 0), row(1, 0)], "level 1 twice"),
        ([row(1, 0, comfort_level="")], "comfort_level=''"),
        ([row(1, 0, success="")], "success= is missing"),
    ],
)
def test_episodes_that_do_not_compare_are_named(rows, says):
    with pytest.raises(ConfigError, match=says):
        data(rows)
