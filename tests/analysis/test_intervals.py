import json

import numpy as np
import pytest
from pandas import DataFrame
from scipy import stats

from hrl_comfort.analysis.intervals import SHARE, Clusters
from hrl_comfort.analysis.summary import summarise
from hrl_comfort.config import ConfigError
from hrl_comfort.files.tables import records_of


def episode(index: int, **changes: object) -> dict[str, object]:
    row: dict[str, object] = {
        "task": "pick",
        "policy": "runs/demo/pick",
        "train_seed": 0,
        "episode_seed": 1,
        "episode": index,
        "object": "orange",
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
        "contact": 0,
        "unsafe_contact": "",
        "other_collision": "none",
        "truncated": 0,
    }
    return {**row, **changes}


def summary_of(rows, group_by=(), max_episode_steps=500):
    return summarise(records_of(rows, "episodes"), group_by, max_episode_steps)["groups"]


def test_steps_are_over_successes_and_a_failure_counts_at_the_limit_in_steps_all():
    rows = [episode(0, steps=100), episode(1, steps=140), episode(2, success=0, steps=37)]
    metrics = summary_of(rows)[0]["metrics"]
    assert metrics["steps"]["mean"] == 120
    assert metrics["steps_all"]["mean"] == pytest.approx((100 + 140 + 500) / 3)


def test_distances_are_over_successes_and_as_measured_in_their_twin():
    rows = [episode(0, human_distance_mean_m=1.0), episode(1, success=0, human_distance_mean_m=0.2)]
    metrics = summary_of(rows)[0]["metrics"]
    assert metrics["human_distance_mean_m"]["mean"] == 1.0
    assert metrics["human_distance_mean_m_all"]["mean"] == pytest.approx(0.6)


def test_a_missing_value_is_left_out_and_an_empty_metric_is_absent():
    rows = [episode(0, **{"return": ""}), episode(1, **{"return": 4.0})]
    metrics = summary_of(rows)[0]["metrics"]
    assert metrics["return"]["mean"] == 4.0
    assert metrics["return"]["ci95"] is None
    assert "unsafe_contact" not in metrics


def test_no_success_leaves_steps_absent_but_steps_all_at_the_limit():
    metrics = summary_of([episode(i, success=0) for i in range(4)])[0]["metrics"]
    assert "steps" not in metrics
    assert metrics["steps_all"]["mean"] == 500


def test_groups_are_split_by_level_and_by_the_columns_asked_for():
    rows = [episode(i, comfort_level=level) for level in (1, 10) for i in range(4)]
    groups = summary_of(rows, group_by=["seen"])
    assert [(g["comfort_level"], g["seen"], g["episodes"]) for g in groups] == [
        (1, 0, 2),
        (1, 1, 2),
        (10, 0, 2),
        (10, 1, 2),
    ]
    assert {"task", "policy", "human", "comfort_level", "precision_m", "metrics"} <= groups[0].keys()
    assert "spawn_id" not in groups[0]["metrics"]


def test_comfort_off_is_null_in_the_file():
    group = json.loads(json.dumps(summary_of([episode(0)])))[0]
    assert group["comfort_level"] is None
    assert group["precision_m"] == 0.1


def test_collisions_are_told_apart():
    kinds = ["none", "table", "self", "table"]
    metrics = summary_of([episode(i, other_collision=kind) for i, kind in enumerate(kinds)])[0]["metrics"]
    shares = [metrics[name]["mean"] for name in ("other_collision", "table_collision", "self_collision")]
    assert shares == [0.75, 0.5, 0.25]


def clusters(seed, spawn):
    return Clusters(np.asarray(seed), np.asarray(spawn))


def test_over_seeds_the_interval_is_students_over_the_means_of_the_seeds():
    rng = np.random.default_rng(0)
    seed, values = np.repeat(np.arange(5), 40), rng.normal(0, 1, 200) + np.repeat(rng.normal(0, 2, 5), 40)
    found = clusters(seed, np.tile(np.arange(40), 5)).estimate(values)
    means = values.reshape(5, 40).mean(axis=1)
    assert found["mean"] == pytest.approx(means.mean())
    assert found["ci95"] == pytest.approx(list(stats.t.interval(0.95, 4, means.mean(), stats.sem(means))))


def test_within_a_seed_the_interval_is_the_bootstrap_over_spawn_points():
    rng = np.random.default_rng(3)
    spawn, effect = np.repeat(np.arange(19), 50), rng.normal(0, 1, 19)
    values = effect[spawn] + rng.normal(0, 0.1, len(spawn))
    low, high = clusters(np.zeros_like(spawn), spawn).estimate(values)["ci95"]
    means = values.reshape(19, 50).mean(axis=1)
    theirs = stats.bootstrap((means,), np.mean, method="percentile", n_resamples=5000, rng=rng).confidence_interval
    assert (low, high) == pytest.approx((theirs.low, theirs.high), abs=0.05)
    assert high - low > 5 * 2 * 1.96 * stats.sem(values), "episodes at a spawn point are not independent"


def test_the_bootstrap_over_spawn_points_covers_the_mean():
    rng = np.random.default_rng(5)
    spawn, covered = np.repeat(np.arange(25), 8), 0
    for _ in range(100):
        values = rng.normal(0, 1, 25)[spawn] + rng.normal(0, 1, len(spawn))
        low, high = clusters(np.zeros_like(spawn), spawn).estimate(values)["ci95"]
        covered += low < 0 < high
    assert 84 <= covered <= 99, "95 % nominal; percentile intervals of 25 clusters are a little narrow"


def test_a_ratio_has_the_interval_of_the_ratio_and_rows_that_lack_a_value_do_not_count():
    rng = np.random.default_rng(1)
    spawn = np.repeat(np.arange(12), 10)
    before = rng.uniform(1, 2, 12)[spawn]
    after = np.where(np.arange(120) % 7, 0.5 * before + rng.normal(0, 1e-3, 120), np.nan)
    found = clusters(np.zeros_like(spawn), spawn).estimate(before, after, statistic=lambda a, b: b / a)
    assert found["mean"] == pytest.approx(0.5, abs=1e-3)
    assert found["ci95"] == pytest.approx([0.5, 0.5], abs=1e-3), "what spawn points do to both cancels"


@pytest.mark.parametrize("seeds", [1, 12])
def test_many_columns_have_the_means_and_intervals_of_each_alone(seeds):
    rng = np.random.default_rng(0)
    values = DataFrame(rng.normal(size=(360, 5))).rename(columns=str)
    values.iloc[::7, 1], values["3"] = np.nan, np.nan
    clusters = Clusters(np.arange(360) % seeds, np.arange(360) % 19)
    found = clusters.estimates(values, {"0": SHARE})
    bounds = {"0": {"bounds": SHARE}}
    alone = {name: clusters.estimate(values[name].to_numpy(), **bounds.get(name, {})) for name in values}
    assert found == {name: estimate for name, estimate in alone.items() if estimate is not None} and len(found) == 4


def test_where_all_agree_or_there_is_one_cluster_no_interval_is_given():
    values = np.array([1.0, np.nan, 3.0])
    assert clusters(np.zeros(3, int), np.zeros(3, int)).estimate(values) == {"mean": 2.0, "ci95": None}
    assert clusters(np.zeros(3, int), np.arange(3)).estimate(np.ones(3)) == {"mean": 1.0, "ci95": None}
    assert clusters(np.arange(3), np.arange(3)).estimate(np.full(3, np.nan)) is None
    one_seed_alone = clusters(np.array([0, 0, 1]), np.arange(3)).estimate(np.array([1.0, 2.0, np.nan]))
    assert one_seed_alone == {"mean": 1.5, "ci95": None}


def test_episodes_without_a_spawn_point_are_clusters_of_their_own():
    found = Clusters.of(DataFrame({"train_seed": 0, "spawn_id": [3, None, None, 3]}))
    assert len(set(found.spawn)) == 3 and found.spawn[0] == found.spawn[3]


def test_a_share_stays_between_0_and_1():
    shares = np.array([0.9, 1.0, 1.0])
    low, high = clusters(np.arange(3), np.arange(3)).estimate(shares, bounds=SHARE)["ci95"]
    assert low < 0.9 and high == 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"success": ""}, "line 3: success= is missing"),
        ({"return": "inf"}, "line 3: return=inf is not finite"),
        ({"contact": "maybe"}, "line 3: contact=maybe is neither True nor False"),
    ],
)
def test_a_bad_cell_is_named(changes, message):
    with pytest.raises(ConfigError, match=message):
        summary_of([episode(0), episode(1, **changes)])


def test_an_unknown_group_column_is_named_with_those_there_are():
    with pytest.raises(ConfigError, match=r"group_by='shade'.*object"):
        summary_of([episode(0)], group_by=["shade"])
