"""Endings: what one policy leaves is what the next begins with, and the evaluation set stays held out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import (
    FIRST_SEED,
    TERMINAL_STATES_SEED,
    VALIDATION_SEED,
    ConfigError,
    EnvConfig,
    EvaluateConfig,
    TrainConfig,
)
from hrl_comfort.config.constants import TRAIN_SEED
from hrl_comfort.evaluation import handover, terminal_states
from hrl_comfort.evaluation.terminal_states import record_terminal_states
from hrl_comfort.files.run_config import environment
from hrl_comfort.sim.engine import Engine

COARSE = ["task=pick", "policy=expert", "human=none", "task.precision.grasp_tolerance_m=0.3"]


def chosen(*overrides: str) -> EvaluateConfig:
    config = compose("evaluate", [*COARSE, "episodes=8", *overrides])
    assert isinstance(config, EvaluateConfig)
    return config


def placing(start: Path, *overrides: str) -> EnvConfig:
    config = compose("train", ["task=place", f"task.start='{start}'", *overrides])
    assert isinstance(config, TrainConfig)
    return environment(config)


def test_place_begins_where_pick_ended(tmp_path: Path) -> None:
    path = record_terminal_states(chosen(f"terminal_states='{tmp_path}/terminal_states.npz'"))
    with np.load(path) as file:
        orange, pink = file["orange"], file["pink"]
    assert len(orange) + len(pink) == 8 and orange.shape[1:] == (18,)
    engine = Engine(placing(path, "human=none"), 8, 0)
    state = engine.reset()
    for row, kind in enumerate(state.target_kind.tolist()):
        bank = (orange, pink)[kind]
        assert np.isin(state.joint_target[row].numpy(), bank[:, 12:]).all()
    distance = (state.tcp_pos - state.target_object).norm(dim=-1)
    assert (distance < 0.3 + 0.05).all(), "the tool is at the object"


def test_a_handover_records_other_episodes_than_those_that_a_skill_was_trained_from(tmp_path: Path) -> None:
    paths = [tmp_path / "trained.npz", tmp_path / "new.npz"]
    for path, first in zip(paths, (TERMINAL_STATES_SEED, handover.FIRST_SEED), strict=True):
        record_terminal_states(chosen("task.object_jitter_m=0.02", f"terminal_states='{path}'"), first)
    trained, new = ({tuple(row) for kind in ("orange", "pink") for row in np.load(path)[kind]} for path in paths)
    assert trained and new and not trained & new
    batches = handover.RECORDED_EPISODES // terminal_states.BATCH
    assert TERMINAL_STATES_SEED + batches < handover.FIRST_SEED < TRAIN_SEED - batches


def test_person_and_level_of_an_ending_come_with_it(tmp_path: Path) -> None:
    walking = ["human=random_walk", "comfort=conditioned"]
    path = record_terminal_states(chosen(*walking, f"terminal_states='{tmp_path}/terminal_states.npz'"))
    with np.load(path) as file:
        banks = [file[kind].astype(np.float64) for kind in ("orange", "pink")]
    state = Engine(placing(path, *walking), 16, 0).reset()
    for row, kind in enumerate(state.target_kind.tolist()):
        here = torch.cat([state.joint_target[row], state.humans_pos[row, 0], state.level[row, None]]).numpy()
        apart = np.abs(banks[kind][:, 12:] - here)
        assert (apart.max(axis=1) < 1e-6).any(), "all of one ending"
    assert len(set(state.level.tolist())) > 2


def test_a_fraction_of_the_starts_meets_a_person_and_a_level_drawn_anew(tmp_path: Path) -> None:
    starts = np.zeros((3, 21))
    starts[:, 18:] = [1.2, 0.9, 10.0]
    np.savez(tmp_path / "starts.npz", orange=starts, pink=starts)

    def recorded(fraction: float) -> list[bool]:
        config = placing(tmp_path / "starts.npz", "comfort=conditioned", f"task.resample_start_probability={fraction}")
        draws = Engine(config, 1, 0).episodes.sampler
        first = [next(draws.attempts(row, 0)) for row in range(64)]
        assert all(draw.spawn_id == -1 or draw.level[0] != 0.95 for draw in first), "both or neither"
        return [draw.spawn_id == -1 and draw.level[0] == 0.95 for draw in first]

    assert all(recorded(0.0)) and not any(recorded(1.0))
    assert 16 < sum(recorded(0.5)) < 48


def test_no_training_begins_with_a_person_at_a_held_out_spawn_point(tmp_path: Path) -> None:
    config = placing(tmp_path / "starts.npz", "comfort=conditioned")
    unseen = np.array(config.human.spawns_m)[config.human.held_out[0]]
    starts = np.zeros((3, 21))
    starts[:, 18:20], starts[:, 20] = [[1.2, 0.9], unseen, unseen + 0.01], [1.0, 2.0, 3.0]
    np.savez(tmp_path / "starts.npz", orange=starts, pink=starts)
    kept = Engine(config, 2, 0).episodes.sampler
    assert [bank[:, 20].tolist() for bank in kept._recorded] == [[1.0], [1.0]]
    np.savez(tmp_path / "starts.npz", orange=starts[1:], pink=starts[1:])
    with pytest.raises(ConfigError, match=r"human\.spawn_margin_m=0\.1 of a held-out spawn point"):
        Engine(config, 2, 0)


def test_levels_that_a_training_does_not_have_are_refused(tmp_path: Path) -> None:
    starts = np.column_stack([np.zeros((3, 20)), [1.0, 10.0, 11.0]])
    np.savez(tmp_path / "starts.npz", orange=starts, pink=starts)
    with pytest.raises(ConfigError, match="levels that are not in 1 to 10"):
        Engine(placing(tmp_path / "starts.npz", "comfort=conditioned"), 2, 0)


def test_recording_again_gives_the_same_endings(tmp_path: Path) -> None:
    paths = [record_terminal_states(chosen(f"terminal_states='{tmp_path}/{name}.npz'")) for name in ("a", "b")]
    first, second = (np.load(path) for path in paths)
    assert all(np.array_equal(first[kind], second[kind]) for kind in ("orange", "pink"))


def test_no_training_draws_from_the_seeds_of_endings_or_evaluation() -> None:
    assert VALIDATION_SEED < TERMINAL_STATES_SEED < FIRST_SEED
    for seed in (VALIDATION_SEED, TERMINAL_STATES_SEED, FIRST_SEED, -1):
        with pytest.raises(ConfigError, match=f"episode_seed={seed}"):
            compose("train", [f"episode_seed={seed}"])
    with pytest.raises(ConfigError, match="episode_seed=0"):
        compose("evaluate", ["episode_seed=0"])


@pytest.mark.parametrize(
    ("overrides", "says"),
    [
        (["terminal_states=endings"], "terminal_states='endings' must be the path of an .npz"),
        (["terminal_states=e.npz", "task.object=pink"], "task.object='pink'"),
    ],
)
def test_endings_that_cannot_be_starts_are_refused_before_anything_runs(overrides: list[str], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        record_terminal_states(chosen(*overrides))


def test_nothing_is_written_when_no_episode_succeeds(tmp_path: Path) -> None:
    config = chosen(f"terminal_states='{tmp_path}/e.npz'", "policy=random", "task.max_episode_steps=5")
    with pytest.raises(ConfigError, match="no orange episode succeeded"):
        record_terminal_states(config)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["cut short", "one array", "text", "wrong shape"])
def test_a_damaged_start_file_is_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "starts.npz"
    if kind == "text":
        path.write_text("orange,pink")
    elif kind == "one array":
        with path.open("wb") as file:
            np.save(file, np.zeros((3, 18)))
    else:
        width = 17 if kind == "wrong shape" else 18
        np.savez(path, orange=np.zeros((4, width)), pink=np.zeros((4, width)))
        if kind == "cut short":
            path.write_bytes(path.read_bytes()[:100])
    config = placing(path)
    with pytest.raises(ConfigError, match=r"task\.start="):
        Engine(config, 2, 0)
