"""Every learner of skills keeps to one contract, built in or a user's: it trains, resumes, is kept and acts."""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import pytest
import torch

from hrl_comfort.agents import checkpoint
from hrl_comfort.agents.learners import HIERARCHICAL, METHODS, SKILLS
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.config.checks import plugins
from hrl_comfort.config.overrides import choices
from hrl_comfort.deploy.export import export
from hrl_comfort.evaluation.handover import handover
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.files.run_config import load_config
from hrl_comfort.policies.actor import ActorPolicy, load_policy
from hrl_comfort.policies.graph import read_onnx
from hrl_comfort.policies.load import make_policy
from hrl_comfort.sim.engine import Engine
from hrl_comfort.studio.session import Session
from hrl_comfort.studio.web import content
from hrl_comfort.tasks.observations.standard import joint_error
from hrl_comfort.training.collector import make_collector
from hrl_comfort.training.trainer import Training, train
from tests.point_env import Stopped, make_points, small_config

DOCS = Path(__file__).parents[2] / "docs"
EVERY = [*SKILLS, *HIERARCHICAL, "td3:TD3", "entry"]
SHORT = ("agent.policy_steps=640", "agent.checkpoint_every=160", "agent.learning_starts=160", "agent.batch_size=16")
OF_POINTS = {
    "hiro": ("agent.own.goals=[0,1]",),
    "end_to_end": ("agent.own.skills=[near,far]", "agent.own.stages=[1,2]", "agent.critic_warmup_updates=0"),
}
SKILLS_OF_CYCLE = ("pick", "place", "return")
MODULE = """
import torch
from td3 import TD3

class NoUpdate(TD3):
    update = None

class NoPolicy(TD3):
    def __init__(self, *sizes):
        super().__init__(*sizes)
        del self.policy

class Undefined(TD3):
    def act(self, now, exploration):
        return super().act(now, exploration) * float("nan")

class Narrow(TD3):
    def act(self, now, exploration):
        return super().act(now, exploration)[:, :1]

class Wide(TD3):
    def __init__(self, config, observation_dim, actions, own):
        super().__init__(config, observation_dim, actions, own)
        self.policy = torch.nn.Linear(observation_dim, actions + 2)

class Timeless(TD3):
    def act(self, now):
        return super().act(now, 0.0)

def made(*sizes):
    return TD3(*sizes)

for name in ("act", "observe", "update", "state_dict", "load_state_dict"):
    setattr(made, name, getattr(TD3, name))
"""


@pytest.fixture(autouse=True)
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Put the learner of the documentation on the path; an installed package offers it too, as `entry`."""
    (tmp_path / "others.py").write_text(MODULE, encoding="utf-8")
    info = tmp_path / "others-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: others\nVersion: 1.0\n", encoding="utf-8")
    (info / "entry_points.txt").write_text("[hrl_comfort.agent.name]\nentry = td3:TD3\n", encoding="utf-8")
    for folder in (DOCS, tmp_path):
        monkeypatch.syspath_prepend(str(folder))
    plugins.cache_clear()
    yield
    for name in ("others", "td3"):
        sys.modules.pop(name, None)
    plugins.cache_clear()


def config_of(folder: Path, name: str, *overrides: str) -> TrainConfig:
    return small_config(folder, f"agent={name}", *SHORT, *OF_POINTS.get(name, ()), *overrides)


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "metrics.csv").open() as file:
        return list(csv.DictReader(file))


def in_cell(folder: Path, name: str) -> Path:
    """Train for some decisions in a cell."""
    cell = ("task=reach", "human=none", "curriculum=off", "engine.num_envs=4", "agent.policy_steps=48")
    few = ("agent.learning_starts=16", "agent.checkpoint_every=48", "agent.target_entropy=-6")
    return train(config_of(folder, name, *cell, *few))


def test_every_built_in_learner_is_a_choice_of_its_group() -> None:
    built_in = {**SKILLS, **HIERARCHICAL}
    assert set(built_in) <= set(choices("agent"))
    for name, kind in built_in.items():
        agent = compose("train", [f"agent={name}"]).agent
        assert agent.name == name and set(agent.own) == {each.name for each in fields(kind.Keys)}


@pytest.mark.parametrize("name", EVERY)
def test_a_learner_trains_stops_and_goes_on_bit_for_bit(name: str, tmp_path: Path) -> None:
    whole = train(config_of(tmp_path / "whole", name), make_points)
    half, config = tmp_path / "half", config_of(tmp_path / "half", name)
    with pytest.raises(Stopped):
        train(config, lambda own: make_points(own, 60))
    train(replace(config, resume=str(half)), make_points)
    assert (half / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()
    one, other = (checkpoint.load(folder / "policy.pt")["networks"] for folder in (half, whole))
    for part, tensors in one.items():
        for key, tensor in tensors.items() if isinstance(tensors, dict) else ():
            assert torch.equal(tensor, other[part][key]), f"{part} {key}"
    last = rows(whole)[-1]
    learnt = [float(value) for column, value in last.items() if column.endswith("_loss")]
    assert len(learnt) >= 2 and all(map(math.isfinite, learnt)) and int(last["updates"]) > 0


@pytest.mark.parametrize("name", EVERY)
def test_what_a_learner_leaves_acts_in_evaluation_studio_and_other_programs(name: str, tmp_path: Path) -> None:
    run = in_cell(tmp_path / "run", name)
    policy, seen = load_policy(run), torch.randn(5, 30)[:, : load_policy(run).spec["observation_dim"]]
    seen = torch.nn.functional.pad(seen, (0, policy.spec["observation_dim"] - seen.shape[1]))
    action = policy(seen)
    assert torch.equal(action, policy(seen)) and action.abs().max() <= 1 and action.shape == (5, 6)
    assert isinstance(policy, ActorPolicy) is (name in SKILLS) and policy.spec["learner"] == name
    torch.testing.assert_close(load_policy(run / "checkpoints" / "step_000000048.pt")(seen), action)
    asked = compose("evaluate", [f"policy='{run}'", "episodes=2", "task.max_episode_steps=40"])
    assert len(rollout(asked).episodes) == 2  # type: ignore[arg-type]
    session = Session(compose("studio", [f"policy='{run}'"]))  # type: ignore[arg-type]
    assert session.step().clip.duration_s > 0
    session.close()
    if name not in SKILLS:
        with pytest.raises(ConfigError, match=rf"^policy=.* is of agent.name={name}, which keeps no critics; choose"):
            load_policy(run, critics=True)
        skills = [f"policies.{each}='{run}'" for each in ("pick", "place", "return")]
        chain = ["task=cycle", "meta_controller=nearest", *skills, f"output='{tmp_path / 'seams'}'"]
        with pytest.raises(ConfigError, match=r"^policies\.pick=.* has no normaliser to tell what is far from its"):
            handover(compose("evaluate", chain))  # type: ignore[arg-type]
    asked_out = compose("export", [f"policy='{run}'", f"output='{tmp_path / 'out'}'"])
    if policy.memory_dim is not None:
        with pytest.raises(ConfigError, match=r"^policy=.* has a memory; export takes those that act by what they see"):
            export(asked_out)  # type: ignore[arg-type]
        with pytest.raises(ConfigError, match=r"^policy=.* has a memory, which a page of export= does not keep$"):
            content.refuse(compose("studio", [f"policy='{run}'"]))  # type: ignore[arg-type]
        return
    out = export(asked_out)  # type: ignore[arg-type]
    engine = Engine(load_config(run), 3, 0)  # type: ignore[arg-type]
    state = engine.reset()
    acts = make_policy(str(run), engine.episodes.subtask, engine.scene, engine.episodes.config, 0)
    torch.testing.assert_close(read_onnx(f"onnx:{out / 'reach.onnx'}")(state), acts(state), atol=1e-4, rtol=1e-4)
    engine.close()


@pytest.mark.parametrize("name", SKILLS)
def test_a_built_in_learner_goes_through_stages_and_values_what_it_leads_to(name: str, tmp_path: Path) -> None:
    stages = "curriculum.stages=[{name:a,policy_steps:320},{name:b,policy_steps:320}]"
    run = train(config_of(tmp_path / "run", name, stages), make_points)
    assert {row["stage"] for row in rows(run)} == {"a", "b"}
    policy, seen = load_policy(run, critics=True), torch.randn(6, 3)
    assert isinstance(policy, ActorPolicy)
    again = Training(config_of(tmp_path / "on", name, f"initial_policy='{run}'"), make_points, tmp_path / "on")
    critics = again.learner.critics
    torch.testing.assert_close(critics.value(policy.normaliser(seen), policy(seen)).detach(), policy.value(seen))
    other = next(each for each in SKILLS if each != name)
    with pytest.raises(ConfigError, match=f"has learner={name}, this training {other}"):
        Training(config_of(tmp_path / "on", other, f"initial_policy='{run}'"), make_points, tmp_path / "on")


@pytest.mark.parametrize("name", HIERARCHICAL)
def test_a_learner_with_a_hierarchy_of_its_own_goes_through_stages(name: str, tmp_path: Path) -> None:
    stages = "curriculum.stages=[{name:a,policy_steps:320},{name:b,policy_steps:320}]"
    run = train(config_of(tmp_path / "run", name, stages), make_points)
    assert {row["stage"] for row in rows(run)} == {"a", "b"}


def test_skills_go_on_from_the_policies_of_a_chain_each_in_its_stage(tmp_path: Path) -> None:
    cell = ("human=none", "curriculum=off", "engine.num_envs=4", "agent.policy_steps=48", "agent.target_entropy=-6")
    chain = {name: train(small_config(tmp_path / name, f"task={name}", *SHORT, *cell)) for name in SKILLS_OF_CYCLE}
    words = ("agent=end_to_end", "task=cycle", f"initial_policy='{tmp_path}'", *SHORT, *cell)
    training = Training(small_config(tmp_path / "cycle", *words), make_collector, tmp_path / "cycle")
    whole = training.collector.observation_dim
    for index, (name, run) in enumerate(chain.items()):
        seen = torch.randn(5, whole)
        seen[:, 36:] = torch.eye(3)[index]
        torch.testing.assert_close(training.learner.policy(seen), load_policy(run)(seen[:, :36]), msg=name)
    training.collector.close()
    (tmp_path / "place").rename(tmp_path / "other")
    with pytest.raises(ConfigError, match=r"place"):
        Training(small_config(tmp_path / "cycle", *words), make_collector, tmp_path / "cycle")


@pytest.mark.parametrize(
    ("words", "joints", "stage"),
    [
        (["task=cycle"], range(12, 18), range(36, 39)),
        (["task=cycle", "task.observation=sight"], range(10, 16), range(78, 81)),
        (["task=cycle", "robot=tests.scene.test_mjcf_arm:SEVEN"], range(14, 21), range(40, 43)),
    ],
)
def test_columns_are_found_by_the_names_of_the_observation(
    words: list[str], joints: range, stage: range, tmp_path: Path
) -> None:
    few = ("human=none", "engine.num_envs=2", "agent.hidden=[8]", "agent.buffer_size=64", "agent.batch_size=16")
    for name, key, columns in (("hiro", "goals", joints), ("end_to_end", "stages", stage)):
        config = small_config(tmp_path, f"agent={name}", *words, *few)
        training = Training(config, make_collector, tmp_path)
        env = training.collector._env
        state = env.engine.episodes.state.with_(stage=torch.tensor([1, 2]))
        seen = env.engine.episodes.subtask.observe(state)
        assert training.spec()["agent"]["own"][key] == list(columns)
        if name == "hiro":
            torch.testing.assert_close(seen[:, training.learner.goals.columns], joint_error(state))
        else:
            assert training.learner.policy.split(seen)[0].tolist() == [1, 2]
        training.collector.close()


def test_columns_without_such_a_name_get_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"^agent\.own\.goals=\['joint_error'\]: no part of the observation has a"):
        Training(small_config(tmp_path, "agent=hiro"), make_points, tmp_path)
    odd = small_config(tmp_path, "agent=end_to_end", "task=pick")
    with pytest.raises(ConfigError, match=r"^agent\.own\.stages=\['stage'\]: the observation has joint_angles, "):
        Training(odd, make_collector, tmp_path)
    for wrong in ("-1", "1.5", "true", "''"):
        with pytest.raises(ConfigError, match=r"^agent\.own\.goals\.0=.* is neither a column, 0 to 1000000, nor "):
            small_config(tmp_path, "agent=hiro", f"agent.own.goals=[{wrong}]")


def test_the_learner_of_the_documentation_is_short_and_has_keys_of_its_own(tmp_path: Path) -> None:
    assert len((DOCS / "td3.py").read_text(encoding="utf-8").splitlines()) <= 60
    training = Training(config_of(tmp_path, "td3:TD3", "agent.own.noise=0.5"), make_points, tmp_path)
    assert training.learner.noise == 0.5


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["agent=others:NoUpdate"], rf"agent\.name='others:NoUpdate' has no update; .* has {', '.join(METHODS)}$"),
        (["agent=others:NoPolicy"], r"agent\.name='others:NoPolicy' has no policy, a torch module of observations$"),
        (["agent=others:Undefined"], r"agent\.name='others:Undefined': act returned .*; it must return finite floats"),
        (["agent=others:Narrow"], r"agent\.name='others:Narrow': act .* of shape \(\d+, 1\); .* of shape \(\d+, 2\)$"),
        (["agent=others:Wide"], r"agent\.name='others:Wide': policy returned \(1, 4\); .* numbers of shape \(1, 2\)$"),
        (["agent=others:Timeless"], r"agent\.name='others:Timeless': act must be a function of self, now, expl"),
        (["agent=others:made"], r"agent\.name='others:made' is of type function; it must be a class$"),
        (["agent=others:nobody"], r"agent\.name='others:nobody': .*others\.py has no nobody$"),
        (["agent=nowhere:TD3"], r"agent\.name='nowhere:TD3' cannot be imported: No module named 'nowhere'$"),
        (["agent=td3:TD3", "agent.own.loud=1"], r"agent\.own\.loud is not a key; agent\.name=td3:TD3 has agent\.own"),
        (["agent=td3:TD3", "agent.own.noise=loud"], r"agent\.own\.noise='loud': Input should be a valid number"),
        (["agent=sac", "agent.own.critics=3"], r"agent\.own\.critics is not a key; agent\.name=sac has none of its"),
        (["agent=tqc", "agent.own.dropped=25"], r"agent\.own\.dropped=25 is outside its range \[0, 24\]$"),
        (["agent=redq", "agent.own.subset=11"], r"agent\.own\.subset=11 is outside its range \[1, 10\]$"),
        (["agent=ppo"], "agent=ppo is not a choice"),
        (["agent=td3:TD3", "initial_policy=runs/reference/pick"], r"initial_policy=.*: this agent\.name has no load_"),
        (
            ["agent=td3:TD3", "curriculum.stages=[{name:a,policy_steps:320},{name:b,policy_steps:320}]"],
            r"curriculum\.stages: agent\.name='td3:TD3' has no begin_stage; choose \[\]$",
        ),
    ],
)  # fmt: skip
def test_a_learner_that_breaks_the_contract_gets_one_line(words: list[str], message: str, tmp_path: Path) -> None:
    def asked() -> None:
        train(small_config(tmp_path / "run", *words), make_points)

    with pytest.raises(ConfigError, match=f"^{message}"):
        asked()


def test_a_policy_whose_learner_is_gone_gets_one_line(tmp_path: Path) -> None:
    run = train(config_of(tmp_path / "run", "td3:TD3"), make_points)
    state = checkpoint.load(run / "policy.pt")
    for changes, message in (
        ({"learner": "gone:TD3"}, r"policy=.*: agent\.name='gone:TD3' cannot be imported"),
        ({"learner": "sac"}, r"policy=.* is damaged: its learner is 'sac'"),
        ({"learner": 3}, r"policy=.* is damaged: its learner is 3"),
        ({"agent": None}, r"policy=.* is damaged: 'NoneType' object is not a mapping"),
        ({"action_dim": 3}, r"policy=.* is damaged: Error\(s\) in loading state_dict"),
    ):
        spec = {**state["spec"], **changes}
        if "learner" in changes and isinstance(spec["learner"], str):
            spec["agent"] = {**spec["agent"], "name": changes["learner"]}
        checkpoint.save(tmp_path / "odd.pt", {**state, "spec": spec})
        with pytest.raises(ConfigError, match=message):
            load_policy(tmp_path / "odd.pt")
