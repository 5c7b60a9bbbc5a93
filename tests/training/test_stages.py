"""Trainings in stages: values in force, what is carried over, exact resume, and refusals in one line."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
import torch

from hrl_comfort.agents import checkpoint
from hrl_comfort.composition.compose import compose
from hrl_comfort.composition.stages import stages_of
from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.files.run_config import load_config
from hrl_comfort.training.collector import SkillCollector
from hrl_comfort.training.trainer import Training, train
from tests.point_env import PointEnv, make_points, small_config
from tests.stopping import stopping

STAGES = (
    "curriculum.stages=["
    "{name:first,policy_steps:560,set:{agent.learning_rate:1e-3,agent.demonstrator:potential_field,"
    "agent.demonstrator_envs:2}},"
    "{name:second,policy_steps:480,set:{agent.ema_rate:0.01,agent.critic_warmup_updates:20,curriculum.kind:linear}},"
    "{name:third,policy_steps:520,set:{curriculum.kind:off},replay:keep,optimiser:keep}]"
)


def staged(folder: Path, *overrides: str, **changes: object) -> TrainConfig:
    # an override of the budget would scale the stages
    config = small_config(folder, STAGES, "agent.policy_steps=1560", *overrides, **changes)
    assert [stage.policy_steps for stage in config.curriculum.stages] == [560, 480, 520]
    return config


def make(config: TrainConfig) -> SkillCollector:
    """Points, some of which a demonstrator moves where the stage asks for one."""
    if config.agent.demonstrator is None:
        return make_points(config)
    env = PointEnv(config.engine.num_envs, config.episode_seed)
    return SkillCollector(config.agent, env, lambda rows: -env.point[rows].clamp(-1, 1))


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "metrics.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training of three stages that nothing stopped."""
    return train(staged(tmp_path_factory.mktemp("runs") / "whole"), make)


def test_the_log_names_the_stage_and_ends_a_row_with_it(whole):
    assert [(row["policy_steps"], row["stage"]) for row in rows(whole)] == [
        *(("200", "first"), ("400", "first"), ("560", "first"), ("600", "second"), ("800", "second")),
        *(("1000", "second"), ("1040", "second"), ("1200", "third"), ("1400", "third"), ("1560", "third")),
    ]
    assert float(rows(whole)[-1]["precision_m"]) == 0.1, "the third is at the task's own precision"
    assert load_config(whole) == staged(whole)


@pytest.mark.parametrize("at", [304, 400, 560, 568, 800, 1040, 1048, 1480])
def test_a_staged_training_stopped_anywhere_goes_on_bit_for_bit(whole, tmp_path, at):
    folder = tmp_path / "run"
    with stopping(Training, "step", lambda training: training.steps >= at):
        train(staged(folder), make)
    train(staged(folder, resume=str(folder)), make)
    assert (folder / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()
    mine, theirs = (checkpoint.load(each / "policy.pt")["networks"]["actor"] for each in (folder, whole))
    assert all(torch.equal(mine[key], theirs[key]) for key in theirs)


def test_a_staged_training_stopped_at_each_boundary_goes_on_bit_for_bit(whole, tmp_path):
    folder = tmp_path / "run"
    for index, resume in ((0, None), (1, str(folder))):
        with stopping(Training, "begin_stage", lambda self, at=index: self.index == at and self.steps > 0):
            train(staged(folder, resume=resume), make)
    train(staged(folder, resume=str(folder)), make)
    assert (folder / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


def at_second(folder: Path, *overrides: str) -> Training:
    """A training that has just begun its second stage."""
    training = Training(staged(folder, *overrides), make, folder)
    while training.steps < training.stage.end:
        training.step()
    training.learn()
    training.begin_stage(1)
    return training


def test_a_stage_begins_with_the_policy_before_it_and_forgets_its_transitions_and_moments(tmp_path):
    training = at_second(tmp_path)
    learner, agent = training.learner, training.stage.config.agent
    assert learner.updates == 0.25 * (560 - 200) and learner.config is agent
    assert len(learner.buffer) == 0 and not learner.optimiser.state
    assert learner.optimiser.param_groups[0]["lr"] == agent.learning_rate == 3e-4
    assert not training.collector.demonstrated.any() and training.stage.config.episode_seed == 10_000
    expected = training.learner.actor.state_dict()
    before = {name: tensor.clone() for name, tensor in expected.items()}
    for _ in range(200 // 8):
        training.step()
    training.learn()
    assert learner.updates == 90, "nothing is learnt before learning_starts"
    for _ in range(80 // 8):
        training.step()
    training.learn()
    assert learner.updates == 110
    assert all(torch.equal(tensor, before[name]) for name, tensor in expected.items()), "the critics learn alone"
    training.step()
    training.learn()
    assert not all(torch.equal(tensor, before[name]) for name, tensor in expected.items())


def test_what_is_kept_is_kept(tmp_path):
    training = at_second(tmp_path)
    moments = training.learner.optimiser
    training.begin_stage(2)
    assert training.learner.optimiser is moments
    training = at_second(tmp_path, "curriculum.stages.1.replay=keep")
    assert len(training.learner.buffer) == 560
    updates = training.learner.updates
    training.step()
    training.learn()
    assert training.learner.updates == updates + 2, "a kept buffer is learnt from at once"


def test_the_best_policy_is_of_the_latest_stage_that_had_one(tmp_path):
    training = Training(staged(tmp_path), make, tmp_path)
    verdicts = []
    for stage, successes in ((0, 20), (0, 10), (1, 5), (1, 4)):
        if stage != training.index:
            training.begin_stage(stage)
        training.curriculum.load_state_dict({"precision_m": 0.3, "outcomes": []})
        training.recent = [(0.3, i < successes) for i in range(20)]
        verdicts.append(training._is_best())
    assert verdicts == [True, False, True, False]
    assert training.best["stage"] == "second"


def test_a_mistake_in_a_later_stage_is_named_before_the_first_one_trains(tmp_path):
    config = small_config(tmp_path / "run", "task=pick", STAGES, "curriculum.stages.2.set.human.motion=dance")
    with pytest.raises(ConfigError, match=r"human\.motion='dance'"):
        train(config)
    assert not (tmp_path / "run" / "config.yaml").exists()


def test_stages_do_not_accumulate_and_the_budget_is_theirs():
    config = compose(
        "train", ["curriculum.stages=[{name:a,policy_steps:30,set:{reward.pick:7}},{name:b,policy_steps:70}]"]
    )
    (_, first), (_, second) = stages_of(config)
    assert (first.reward.pick, second.reward.pick) == (7, config.reward.pick)
    assert (config.agent.policy_steps, first.agent.policy_steps) == (100, 30)
    ((stage, only),) = stages_of(config := compose("train"))
    assert stage.name == "train" and only == config


def test_a_budget_asked_for_scales_every_stage():
    stages = "curriculum.stages=[{name:a,policy_steps:100000},{name:b,policy_steps:50000}]"
    config = compose("train", [stages, "agent.policy_steps=1000"])
    assert [stage.policy_steps for stage in config.curriculum.stages] == [667, 333]
    assert config.agent.policy_steps == 1000


def test_a_value_of_a_stage_can_be_overridden():
    stages = "curriculum.stages=[{name:a,policy_steps:10,set:{reward.pick:7}},{name:b,policy_steps:20}]"
    config = compose("train", [stages, "curriculum.stages.1.set.reward.pick=9", "curriculum.stages.0.policy_steps=5"])
    assert [changed.reward.pick for _, changed in stages_of(config)] == [7, 9]
    assert config.agent.policy_steps == 25


@pytest.mark.parametrize(
    ("stage", "said"),
    [
        (
            "{name:a,policy_steps:9,set:{reward.pik:1}}",
            r"^curriculum\.stages\.0\.set: reward\.pik is not a key, did you mean pick",
        ),
        ("{name:a,policy_steps:9,set:{reward.pick:dear}}", r"^curriculum\.stages\.0\.set: reward\.pick='dear'"),
        (
            "{name:a,policy_steps:9,set:{reward.pick:1e9}}",
            r"^curriculum\.stages\.0\.set: reward\.pick=1000000000\.0 is outside",
        ),
        ("{name:a,policy_steps:9,set:{agent.hidden:[8]}}", r"^curriculum\.stages\.0\.set: agent\.hidden cannot change"),
        ("{name:a,policy_steps:9,set:{task.name:pick}}", r"^curriculum\.stages\.0\.set: task\.name cannot change"),
        (
            "{name:a,policy_steps:9,set:{comfort.source:random}}",
            r"^curriculum\.stages\.0\.set: comfort\.source=random changes whether the policy sees the level",
        ),
        ("{name:a,policy_steps:0}", r"^curriculum\.stages\.0\.policy_steps=0 is outside"),
        ("{name:a,policy_steps:9,replay:empty}", r"^curriculum\.stages\.0\.replay='empty' is not allowed"),
        ("{name:a b,policy_steps:9}", r"^curriculum\.stages\.0\.name='a b'"),
        ("{name:a}", r"^curriculum\.stages\.0\.policy_steps must be set"),
        ("{name:a,policy_steps:9},{name:a,policy_steps:9}", r"are named a, a"),
    ],
)
def test_a_stage_that_is_not_allowed_is_named_with_its_key(stage, said):
    with pytest.raises(ConfigError, match=said) as error:
        compose("train", [f"curriculum.stages=[{stage}]"])
    assert "\n" not in str(error.value)
