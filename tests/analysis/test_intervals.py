import csv
import json
import math

import numpy as np
import pytest
from scipy import stats

from hrl_comfort.analysis import intervals as statistics
from hrl_comfort.config import ConfigError


def episode(index: int, **changes: object) -> dict[str, object]:
    row: dict[str, object] = {
        "task": "pick",
        "policy": "runs/demo/pick",
        "train_seed": 0,
        "episode_seed": 1,
        "episode": index,
        "colour": "orange",
        "spawn_id": index % 3,
        "motion_id": index,
        "seen": index % 2,
        "comfort_level": "",
        "human": "random_walk",
        "precision_m": 0.1,
        "success": 1,
        "steps": 100,
        "policy_steps": 20,
        "return": 5.0,
        "human_distance_mean_m": 0.8,
        "human_distance_min_m": 0.5,
        "human_collision": 0,
        "robot_moving_at_collision": "",
        "other_collision": "none",
        "truncated": 0,
    }
    return {**row, **changes}


def write(folder, rows):
    with (folder / "episodes.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def summary_of(folder, rows, group_by=(), max_episode_steps=500):
    write(folder, rows)
    return statistics.write_summary(folder, group_by, max_episode_steps)["groups"]


def test_steps_are_over_successes_and_a_failure_counts_at_the_limit_in_steps_all(tmp_path):
    rows = [episode(0, steps=100), episode(1, steps=140), episode(2, success=0, steps=37)]
    metrics = summary_of(tmp_path, rows)[0]["metrics"]
    assert metrics["steps"]["mean"] == 120
    assert metrics["steps_all"]["mean"] == pytest.approx((100 + 140 + 500) / 3)


def test_distances_are_over_successes_and_as_measured_in_their_twin(tmp_path):
    rows = [episode(0, human_distance_mean_m=1.0), episode(1, success=0, human_distance_mean_m=0.2)]
    metrics = summary_of(tmp_path, rows)[0]["metrics"]
    assert metrics["human_distance_mean_m"]["mean"] == 1.0
    assert metrics["human_distance_mean_m_all"]["mean"] == pytest.approx(0.6)


def test_a_missing_value_is_left_out_and_an_empty_metric_is_absent(tmp_path):
    rows = [episode(0, **{"return": ""}), episode(1, **{"return": 4.0})]
    metrics = summary_of(tmp_path, rows)[0]["metrics"]
    assert metrics["return"]["mean"] == 4.0
    assert metrics["return"]["ci95"] is None
    assert "robot_moving_at_collision" not in metrics


def test_no_success_leaves_steps_absent_but_steps_all_at_the_limit(tmp_path):
    metrics = summary_of(tmp_path, [episode(i, success=0) for i in range(4)])[0]["metrics"]
    assert "steps" not in metrics
    assert metrics["steps_all"]["mean"] == 500


def test_groups_are_split_by_level_and_by_the_columns_asked_for(tmp_path):
    rows = [episode(i, comfort_level=level) for level in (1, 10) for i in range(4)]
    groups = summary_of(tmp_path, rows, group_by=["seen"])
    assert [(g["comfort_level"], g["seen"], g["episodes"]) for g in groups] == [
        (1, 0, 2),
        (1, 1, 2),
        (10, 0, 2),
        (10, 1, 2),
    ]
    assert {"task", "policy", "human", "comfort_level", "precision_m", "metrics"} <= groups[0].keys()
    assert "spawn_id" not in groups[0]["metrics"]


def test_comfort_off_is_null_in_the_file(tmp_path):
    summary_of(tmp_path, [episode(0)])
    group = json.loads((tmp_path / "summary.json").read_text())["groups"][0]
    assert group["comfort_level"] is None
    assert group["precision_m"] == 0.1


def test_collisions_are_told_apart(tmp_path):
    kinds = ["none", "table", "self", "table"]
    metrics = summary_of(tmp_path, [episode(i, other_collision=kind) for i, kind in enumerate(kinds)])[0]["metrics"]
    shares = [metrics[name]["mean"] for name in ("other_collision", "table_collision", "self_collision")]
    assert shares == [0.75, 0.5, 0.25]


def test_full_success_still_has_a_wilson_interval(tmp_path):
    metrics = summary_of(tmp_path, [episode(i) for i in range(100)])[0]["metrics"]
    low, high = metrics["success"]["ci95"]
    assert low == pytest.approx(100 / (100 + 1.959964**2), abs=1e-5)
    assert high == pytest.approx(1)


def test_the_bootstrap_agrees_with_scipy():
    values = np.random.default_rng(3).gamma(2.0, size=200)
    low, high = statistics.bootstrap_interval(values, ["0"] * 200)
    theirs = stats.bootstrap(
        (values,), np.mean, method="percentile", n_resamples=5000, rng=np.random.default_rng(1)
    ).confidence_interval
    assert (low, high) == pytest.approx((theirs.low, theirs.high), abs=0.03)


def test_several_training_seeds_widen_the_interval():
    values = np.repeat([0.0, 1.0, 2.0], 50) + np.random.default_rng(0).normal(0, 0.1, 150)
    one = statistics.bootstrap_interval(values, ["0"] * 150)
    three = statistics.bootstrap_interval(values, [str(i // 50) for i in range(150)])
    assert three[1] - three[0] > 3 * (one[1] - one[0])


def test_the_interquartile_mean_ignores_the_outer_quarters():
    assert statistics.interquartile_mean(np.array([-100.0, 1.0, 2.0, 300.0])) == 1.5


def test_probability_of_improvement_counts_ties_half_and_knows_certainty():
    same = statistics.probability_of_improvement(np.ones(5), np.ones(4))
    sure = statistics.probability_of_improvement(np.array([2.0, 3.0]), np.array([0.0, 1.0]))
    assert same == {"mean": 0.5, "ci95": [0.5, 0.5]}
    assert sure == {"mean": 1.0, "ci95": [1.0, 1.0]}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"success": ""}, "success"),
        ({"return": "inf"}, "return='inf'"),
        ({"human_collision": "maybe"}, "maybe"),
    ],
)
def test_a_bad_cell_is_named(tmp_path, changes, message):
    with pytest.raises(ConfigError, match=message):
        summary_of(tmp_path, [episode(0), episode(1, **changes)])


def test_an_unknown_group_column_is_named_with_those_there_are(tmp_path):
    with pytest.raises(ConfigError, match=r"group_by='shade'.*colour"):
        summary_of(tmp_path, [episode(0)], group_by=["shade"])


def test_empty_cells_are_missing_and_words_for_truth_are_read():
    cells = [statistics.number(cell) for cell in ("", None, "nan")]
    assert all(math.isnan(cell) for cell in cells)
    assert [statistics.number(cell) for cell in ("True", "false", "0.5")] == [1.0, 0.0, 0.5]
