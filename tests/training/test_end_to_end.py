"""The real cell, end to end and small: train, stop and resume, evaluate, report."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
import torch

from hrl_comfort.agents import checkpoint
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig, ReportConfig, TrainConfig
from hrl_comfort.evaluation.evaluate import evaluate
from hrl_comfort.files.run_config import load_config, save_config
from hrl_comfort.policies.actor import load_policy
from hrl_comfort.report.report import report
from hrl_comfort.training.trainer import Training, train
from tests.stopping import stopping

SMALL = [
    "task=pick", "agent.policy_steps=960", "agent.learning_starts=160", "agent.hidden=[16,16]",
    "agent.batch_size=32", "agent.log_every=160", "agent.checkpoint_every=320", "engine.num_envs=8",

]  # fmt: skip


def small(folder: Path, *overrides: str) -> TrainConfig:
    config = compose("train", [*SMALL, f"output='{folder}'", *overrides])
    assert isinstance(config, TrainConfig)
    return config


def evaluation(*overrides: str) -> EvaluateConfig:
    config = compose("evaluate", overrides)
    assert isinstance(config, EvaluateConfig)
    return config


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return train(small(tmp_path_factory.mktemp("run") / "pick"))


def test_a_run_folder_holds_what_the_contract_says(run: Path) -> None:
    for name in ("config.yaml", "provenance.json", "metrics.csv", "timing.csv", "policy.pt", "checkpoints"):
        assert (run / name).exists(), name
    assert list(run.glob("events.out.tfevents.*"))
    provenance = json.loads((run / "provenance.json").read_text(encoding="utf-8"))
    assert provenance["finished"] and provenance["policy_steps"] == 960
    assert load_config(run) == small(run)


def test_a_stopped_training_of_the_cell_resumes_bit_for_bit(run: Path, tmp_path: Path) -> None:
    folder = tmp_path / "pick"
    with stopping(Training, "step", lambda training: training.steps >= 480):
        train(small(folder))
    torch.manual_seed(12345)
    train(small(tmp_path / "unused", f"resume='{folder}'"))
    assert (folder / "metrics.csv").read_bytes() == (run / "metrics.csv").read_bytes()
    observation = torch.linspace(-1, 1, 36).repeat(3, 1)
    assert torch.equal(load_policy(folder)(observation), load_policy(run)(observation))


def test_two_seeds_train_differently(run: Path, tmp_path: Path) -> None:
    other = train(small(tmp_path / "other", "train_seed=1"))
    assert (other / "metrics.csv").read_bytes() != (run / "metrics.csv").read_bytes()


def test_a_run_is_evaluated_with_its_checkpoints_and_reported(run: Path) -> None:
    evaluate(evaluation(f"policy='{run}'", "episodes=4", "record=true", "task.max_episode_steps=60"))
    summary = json.loads((run / "eval" / "summary.json").read_text(encoding="utf-8"))
    (group,) = summary["groups"]
    assert (group["task"], group["human"], group["episodes"]) == ("pick", "random_walk", 4)
    evaluate(evaluation(f"policy='{run}'", "episodes=2", "checkpoints=all", "task.max_episode_steps=60"))
    assert len((run / "eval" / "checkpoints.csv").read_text(encoding="utf-8").splitlines()) == 1 + 3
    page = report(ReportConfig(run=str(run), output=None, video=False))
    text = page.read_text(encoding="utf-8")
    assert "<svg" in text or "data:image" in text


def test_a_policy_of_another_subtask_is_refused_in_one_line(run: Path) -> None:
    with pytest.raises(ConfigError, match="was trained for 'pick', not for 'place'") as error:
        evaluate(evaluation(f"policy='{run}'", "task=place", "episodes=2"))
    assert "\n" not in str(error.value)


def test_training_goes_on_from_a_policy(run: Path, tmp_path: Path) -> None:
    folder = train(small(tmp_path / "on", f"initial_policy='{run}'", "agent.policy_steps=160"))
    assert (folder / "policy.pt").is_file()


@pytest.mark.parametrize("choice", ["robot=ur5e", "task.action_repeat=1", "task.action=cartesian"])
def test_a_policy_is_not_run_in_a_cell_it_was_not_trained_for(run: Path, choice: str) -> None:
    with pytest.raises(ConfigError, match=f"{choice}, but policy="):
        evaluate(evaluation(f"policy='{run}'", choice, "episodes=2"))


def test_a_chain_runs_in_the_cell_of_its_policies(tmp_path: Path) -> None:
    config = small(tmp_path, "robot=ur5e", "human=approach", "task.max_step_deg=1", "task.max_episode_steps=77")
    save_config(config, tmp_path / "config.yaml")
    chained = [
        "task=cycle",
        "meta_controller=nearest",
        f"policies.pick='{tmp_path}'",
        "policies.place=expert",
    ]
    found = evaluation(*chained, "policies.return=expert")
    assert (found.robot, found.human) == (config.robot, config.human)
    assert (found.task.max_step_deg, found.task.max_episode_steps) == (1, 1500), "the cycle keeps its own limit"


def test_a_human_chosen_for_evaluation_is_that_choice_whatever_was_trained_with(tmp_path: Path) -> None:
    save_config(small(tmp_path, "human=approach"), tmp_path / "config.yaml")
    chosen = evaluation(f"policy='{tmp_path}'", "human=random_walk").human
    assert chosen == evaluation("human=random_walk").human


@pytest.mark.parametrize("damage", ["nan", "no spec", "no normaliser", "other width"])
def test_a_damaged_policy_is_refused_in_one_line(run: Path, tmp_path: Path, damage: str) -> None:
    state = checkpoint.load(run / "policy.pt")
    if damage == "nan":
        next(iter(state["networks"]["actor"].values()))[0] = math.nan
    elif damage == "no spec":
        del state["spec"]
    elif damage == "no normaliser":
        del state["networks"]["normaliser"]
    else:
        state["spec"]["hidden"] = [8]
    checkpoint.save(tmp_path / "policy.pt", state)
    file = f"'{tmp_path}/policy.pt'"
    with pytest.raises(ConfigError, match=r"policy\.pt") as in_evaluation:
        evaluate(evaluation(f"policy={file}", "episodes=2", f"output='{tmp_path}/eval'"))
    with pytest.raises(ConfigError, match=r"policy\.pt") as in_training:
        train(small(tmp_path / "on", f"initial_policy={file}"))
    assert "\n" not in f"{in_evaluation.value}{in_training.value}"


def test_a_training_that_ended_before_its_first_checkpoint_leaves_its_folder_free(tmp_path: Path) -> None:
    save_config(small(tmp_path), tmp_path / "config.yaml")
    assert (train(small(tmp_path, "agent.policy_steps=160")) / "policy.pt").is_file()


def test_a_chain_takes_no_policy_and_a_policy_no_chain() -> None:
    with pytest.raises(ConfigError, match="does not go with meta_controller=nearest"):
        evaluation("policy=expert", "task=cycle", "meta_controller=nearest")
    with pytest.raises(ConfigError, match="meta_controller=nearest"):
        evaluation("task=cycle", "policies.pick=expert")
