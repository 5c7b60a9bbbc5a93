"""The training loop on a point that must reach the origin."""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from hrl_comfort.agents import checkpoint
from hrl_comfort.agents.sac import TERMS
from hrl_comfort.config import ConfigError
from hrl_comfort.files.provenance import step_files
from hrl_comfort.files.run_config import load_config
from hrl_comfort.policies.actor import load_policy
from hrl_comfort.training.resume import claim
from hrl_comfort.training.trainer import Training, train
from tests.point_env import PointEnv, interrupted, make_points, small_config


def rows(folder: Path, name: str = "metrics.csv") -> list[dict[str, str]]:
    with (folder / name).open() as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A whole training."""
    return train(small_config(tmp_path_factory.mktemp("runs") / "whole"), make_points)


def test_sac_learns_to_reach_the_origin(tmp_path):
    config = small_config(
        tmp_path / "run", "agent.policy_steps=6000", "agent.buffer_size=6000", "agent.learning_rate=0.003"
    )
    policy = load_policy(train(config, make_points))
    env = PointEnv(64, seed=7)
    env.set_precision(0.15)
    now, solved = env.reset(), torch.zeros(64, 1, dtype=torch.bool)
    for _ in range(19):
        now = env.step(now.set("action", policy(now["observation"])))["next"].exclude("reward")
        solved |= now["success"]
    assert solved.float().mean() > 0.95
    assert float(rows(tmp_path / "run")[-1]["precision_m"]) < 0.3


def test_metrics_have_the_contracts_columns_and_empty_cells_where_nothing_came(run):
    table = rows(run)
    assert list(table[0]) == [
        *("policy_steps", "stage", "updates", "episodes", "precision_m", "success", "return", "steps"),
        *("contact", "unsafe_contact", "other_collision", "shield_share_mean", "protective_stops"),
        *("reward/progress", "reward/reach", *TERMS),
    ]
    assert [row["policy_steps"] for row in table] == [str(n) for n in range(200, 1601, 200)]
    assert all(table[0][term] == "" for term in TERMS)
    assert table[1]["critic_loss"] != ""
    assert int(table[-1]["updates"]) == 0.25 * (1600 - 200)


def test_reward_terms_sum_to_the_return(run):
    for row in rows(run):
        terms = float(row["reward/progress"]) + float(row["reward/reach"])
        assert terms == pytest.approx(float(row["return"]), abs=1e-4)


def test_a_row_without_a_finished_episode_has_empty_outcomes(tmp_path):
    overrides = (
        "curriculum=off",
        "task.precision.grasp_tolerance_m=0.005",
        "agent.log_every=8",
        "agent.policy_steps=160",
    )
    table = rows(train(small_config(tmp_path / "run", *overrides), make_points))
    assert table[0]["episodes"] == "0"
    assert table[0]["success"] == table[0]["return"] == table[0]["reward/reach"] == ""
    assert int(table[-1]["episodes"]) >= 8  # the time limit has ended some
    assert table[-1]["success"] == "0"


def test_the_folder_holds_what_the_contract_says(run):
    assert load_config(run) == small_config(run)
    provenance = json.loads((run / "provenance.json").read_text())
    assert provenance["finished"] is True
    assert provenance["policy_steps"] == 1600
    assert provenance["versions"]["torchrl"] == "0.14.1"
    assert provenance["seeds"] == {"train_seed": 0, "episode_seed": 0}
    assert list(run.glob("events.out.tfevents.*"))
    kept = [path.name for path in step_files(run / "checkpoints")]
    assert kept == ["step_000001504.pt", "step_000001600.pt"]
    assert not (run / "checkpoints" / "latest.pt").exists()
    assert load_policy(run).spec["environment"]["action_repeat"] == 5
    assert set(rows(run, "timing.csv")[0]) == {
        "policy_steps",
        "seconds",
        "policy_steps_per_s",
        "updates_per_s",
    }


def test_the_same_seeds_write_the_same_metrics_and_another_seed_does_not(run, tmp_path):
    again = train(small_config(tmp_path / "again"), make_points)
    other = train(small_config(tmp_path / "other", train_seed=1), make_points)
    assert (again / "metrics.csv").read_bytes() == (run / "metrics.csv").read_bytes()
    assert (other / "metrics.csv").read_bytes() != (run / "metrics.csv").read_bytes()


@pytest.mark.parametrize("calls", [120, 160])
def test_a_training_stopped_half_way_and_resumed_is_bit_for_bit_the_same(run, tmp_path, calls):
    half = interrupted(tmp_path / "half", calls)
    assert len(rows(half)) < len(rows(run))
    config = small_config(Path("elsewhere"), resume=str(half))
    assert train(config, make_points) == half
    assert (half / "metrics.csv").read_bytes() == (run / "metrics.csv").read_bytes()
    mine, whole = checkpoint.load(half / "policy.pt"), checkpoint.load(run / "policy.pt")
    for name, tensor in whole["networks"]["actor"].items():
        assert torch.equal(tensor, mine["networks"]["actor"][name])
    assert len(rows(half, "timing.csv")) == len(rows(run))


def test_resuming_passes_over_a_truncated_checkpoint(run, tmp_path):
    half = interrupted(tmp_path / "half", 160)
    latest = half / "checkpoints" / "latest.pt"
    latest.write_bytes(latest.read_bytes()[:1000])
    with pytest.warns(UserWarning, match=r"latest\.pt"):
        train(small_config(half, resume=str(half)), make_points)
    assert (half / "metrics.csv").read_bytes() == (run / "metrics.csv").read_bytes()


def test_a_killed_process_resumes_bit_for_bit(run, tmp_path):
    script = (
        "import sys; from pathlib import Path; from tests.point_env import *\n"
        "from hrl_comfort.training.trainer import train\n"
        "train(small_config(Path(sys.argv[1])), lambda c: make_points(c, 100, True))"
    )
    folder = tmp_path / "killed"
    command, root = [sys.executable, "-c", script, str(folder)], Path(__file__).parents[2]
    done = subprocess.run(command, cwd=root, capture_output=True, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr.decode()
    train(small_config(folder, resume=str(folder)), make_points)
    assert (folder / "metrics.csv").read_bytes() == (run / "metrics.csv").read_bytes()


def test_a_folder_that_holds_a_run_is_refused(run):
    with pytest.raises(ConfigError, match="already holds a run"):
        train(small_config(run), make_points)


def test_a_folder_in_use_is_refused(tmp_path):
    with claim(tmp_path / "run", resume=False), pytest.raises(ConfigError, match="in use"):
        train(small_config(tmp_path / "run"), make_points)


@pytest.mark.parametrize(("what", "message"), [("finished", "is finished"), ("nothing", "not a run folder")])
def test_what_cannot_be_resumed_is_refused(run, tmp_path, what, message):
    folder = run if what == "finished" else tmp_path / "nothing"
    with pytest.raises(ConfigError, match=message):
        train(small_config(tmp_path, resume=str(folder)), make_points)


def test_training_on_starts_from_the_networks_of_the_run_and_skips_random_actions(run, tmp_path):
    config = small_config(tmp_path / "on", initial_policy=str(run))
    training = Training(config, make_points, tmp_path / "on")
    saved = checkpoint.load(run / "policy.pt")["networks"]
    assert set(saved) == {"actor", "critics", "normaliser", "log_alpha"}
    for module in (training.learner.critics, training.learner.targets):
        for name, tensor in module.state_dict().items():
            assert torch.equal(tensor, saved["critics"][name])
    assert torch.equal(training.learner.log_alpha.detach(), saved["log_alpha"])
    training.step()
    fresh = Training(config, make_points, tmp_path / "on")
    expected = fresh.learner.act(fresh.collector.now)
    assert torch.equal(training.learner.buffer.storage[:8]["action"], expected)


def test_training_on_from_networks_of_another_shape_is_refused(run, tmp_path):
    config = small_config(tmp_path / "on", "agent.hidden=[16,16]", initial_policy=str(run))
    with pytest.raises(ConfigError, match=r"hidden=\[32, 32\], this training \[16, 16\]"):
        train(config, make_points)


def test_best_prefers_the_tighter_precision_then_the_higher_success(tmp_path):
    training = Training(small_config(tmp_path), make_points, tmp_path)
    verdicts = []
    for precision_m, successes in ((0.3, 20), (0.26, 10), (0.26, 9), (0.3, 20), (0.26, 11)):
        training.curriculum.load_state_dict({"precision_m": precision_m, "outcomes": []})
        training.recent = [(precision_m, i < successes) for i in range(20)]
        verdicts.append(training._is_best())
    assert verdicts == [True, True, False, False, True]
    training.recent = training.recent[:19]
    assert not training._is_best()
