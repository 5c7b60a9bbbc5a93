"""The committed evaluation set: it can be made again, and half of it was never seen in training."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hrl_comfort import humans
from hrl_comfort.humans.evaluation import FIRST_SEED
from hrl_comfort.humans.make_evaluation_set import default_choices, evaluation_set
from tests.humans.paper import GOALS, SPAWNS, discs

REPOSITORY = Path(__file__).resolve().parents[2]


def committed() -> str:
    return (REPOSITORY / "hrl_comfort" / "humans" / "evaluation_set.csv").read_text(encoding="utf-8")


def test_remaking_the_evaluation_set_gives_the_committed_file() -> None:
    text = evaluation_set(*default_choices(REPOSITORY / "conf"))
    assert text == committed(), "remake it: python -m hrl_comfort.humans.make_evaluation_set"


def test_the_defaults_in_conf_are_the_authors_cell() -> None:
    config, cell = default_choices(REPOSITORY / "conf")
    assert config.spawns_m == SPAWNS
    np.testing.assert_array_equal(np.array(list(cell.goals.values()))[:, :2], GOALS)


def test_half_of_the_evaluation_set_was_never_a_spawn_in_training() -> None:
    config, _ = default_choices(REPOSITORY / "conf")
    entries = humans.load_evaluation_set()
    assert len(entries.episode) == 1000
    assert entries.seen.sum() == 500
    assert entries.seen[:100].sum() == 50, "a leading part is balanced too"
    assert set(entries.spawn_id[entries.seen]) == set(humans.training_spawns(config))
    assert set(entries.spawn_id[~entries.seen]) == set(config.held_out)
    spawns = humans.moved_spawns(config, GOALS)
    strayed = np.linalg.norm(entries.position - spawns[entries.spawn_id], axis=1)
    assert strayed[entries.seen].max() <= config.spawn_jitter_m + 1e-5


def test_no_unseen_entry_lies_where_training_spawns_people() -> None:
    config, _ = default_choices(REPOSITORY / "conf")
    entries = humans.load_evaluation_set()
    held_out = humans.moved_spawns(config, GOALS)[entries.spawn_id[~entries.seen]]
    strayed = np.linalg.norm(entries.position[~entries.seen] - held_out, axis=1)
    assert config.spawn == "mixed"
    assert strayed.max() < config.spawn_margin_m, "training keeps that far from the held-out points"


def test_evaluation_episodes_begin_outside_the_keep_out_discs_with_seeds_of_their_own() -> None:
    entries = humans.load_evaluation_set()
    assert not discs(1000).entered(entries.position).any()
    assert entries.episode_seed.min() >= FIRST_SEED
    for column in (entries.episode, entries.episode_seed, entries.motion_id):
        assert len(np.unique(column)) == 1000


def test_a_part_of_the_set_and_other_seeds_keep_spawns_and_motions() -> None:
    entries = humans.load_evaluation_set()
    part = entries.part(10, 14).reseeded(5_000_000)
    assert part.episode.tolist() == [10, 11, 12, 13]
    assert part.episode_seed.tolist() == [5_000_010, 5_000_011, 5_000_012, 5_000_013]
    np.testing.assert_array_equal(part.position, entries.position[10:14])
    np.testing.assert_array_equal(part.motion_id, entries.motion_id[10:14])
