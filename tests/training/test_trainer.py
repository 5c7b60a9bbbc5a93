"""The training loop on a point that must reach the origin."""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from hrl_comfort.agents import checkpoint
from hrl_comfort.agents.sac import TERMS
from hrl_comfort.comfort.adapt import with_level
from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.envs.torchrl import CellEnv
from hrl_comfort.files.provenance import step_files
from hrl_comfort.files.run_config import environment, load_config
from hrl_comfort.policies.actor import load_policy
from hrl_comfort.policies.load import make_policy
from hrl_comfort.tasks import subtask
from hrl_comfort.training.collector import Demonstrator, SkillCollector, make_demonstrator
from hrl_comfort.training.next_skill import NextSkill
from hrl_comfort.training.resume import claim
from hrl_comfort.training.trainer import Training, train
from tests.point_env import LIMIT, PointEnv, Stopped, make_points, small_config


def rows(folder: Path, name: str = "metrics.csv") -> list[dict[str, str]]:
    with (folder / name).open() as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A whole training."""
    return train(small_config(tmp_path_factory.mktemp("runs") / "whole"), make_points)


def interrupted(folder: Path, calls: int, *overrides: str, make: Callable[..., SkillCollector] = make_points) -> Path:
    with pytest.raises(Stopped):
        train(small_config(folder, *overrides), lambda config: make(config, calls))
    return folder


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


def homeward(env: PointEnv) -> Demonstrator:
    """A guide that goes straight to the origin."""
    return lambda rows: -env.point[rows].clamp(-1, 1)


def demonstrated(config: TrainConfig, stop_after: int | None = None) -> SkillCollector:
    env = PointEnv(config.engine.num_envs, config.episode_seed, stop_after)
    return SkillCollector(config.agent, env, homeward(env))


DEMONSTRATED = ("agent.demonstrator=potential_field", "agent.demonstrator_envs=2")


def test_guided_rows_act_as_the_guide_does_and_are_remembered_as_such(tmp_path):
    config = small_config(tmp_path, *DEMONSTRATED)
    env = PointEnv(8, 0)
    training = Training(config, lambda _: SkillCollector(config.agent, env, homeward(env)), tmp_path)
    expected = homeward(env)(torch.arange(2))
    training.step()
    stored = training.learner.buffer.storage[:8]
    assert torch.equal(stored["action"][:2], expected)
    assert stored["demonstrated"].tolist() == [True, True, *[False] * 6]


def test_a_guide_that_takes_over_goes_on_to_the_end_of_the_episode(tmp_path):
    config = small_config(tmp_path, *DEMONSTRATED, "agent.demonstrator_takeover=0.5")
    env = PointEnv(8, 0)
    collector = SkillCollector(config.agent, env, homeward(env))
    collector.reset(0.1)
    begun, guided_before = torch.zeros(8, dtype=torch.bool), torch.zeros(8, dtype=torch.bool)
    for _ in range(4 * LIMIT):
        expected = homeward(env)(torch.arange(8))
        transitions = collector.step(torch.ones(8, 2)).transitions
        guided = transitions["demonstrated"]
        assert torch.equal(transitions["action"], torch.where(guided[:, None], expected, torch.ones(8, 2)))
        assert guided[guided_before].all() and not guided[2:].any()
        begun |= ~guided
        guided_before = collector.demonstrated.clone()
    assert begun.all(), "the actor begins some of the first two environments' episodes"


def test_guided_episodes_count_in_no_success(tmp_path):
    config = small_config(tmp_path, *DEMONSTRATED, "curriculum=off", "task.precision.grasp_tolerance_m=0.3")
    env = PointEnv(8, 0)
    training = Training(
        config, lambda _: SkillCollector(config.agent, env, lambda rows: torch.zeros(len(rows), 2)), tmp_path
    )
    ended = 0
    for _ in range(LIMIT):
        env.point[2:] = 0.0  # whoever is not guided is there at once
        finished = training.step()
        assert all(outcome["success"] for outcome in finished)
        ended += len(finished)
    assert ended == 6 * LIMIT


def test_a_guided_training_stopped_half_way_and_resumed_is_bit_for_bit_the_same(tmp_path):
    whole = train(small_config(tmp_path / "whole", *DEMONSTRATED), demonstrated)
    half = interrupted(tmp_path / "half", 120, *DEMONSTRATED, make=demonstrated)
    train(small_config(half, resume=str(half)), demonstrated)
    assert (half / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


def test_a_guide_without_rows_and_rows_without_a_guide_are_refused(tmp_path):
    with pytest.raises(
        ConfigError, match=r"agent\.demonstrator_envs=0 does not go with agent\.demonstrator=potential_field"
    ):
        small_config(tmp_path, "agent.demonstrator=potential_field")
    with pytest.raises(ConfigError, match=r"agent\.demonstrator_envs=2 does not go with agent\.demonstrator=None"):
        small_config(tmp_path, "agent.demonstrator_envs=2")
    with pytest.raises(ConfigError, match=r"agent\.demonstrator_envs=8 must be below engine\.num_envs=8"):
        small_config(tmp_path, "agent.demonstrator=potential_field", "agent.demonstrator_envs=8")
    with pytest.raises(ConfigError, match="this environment knows no demonstrator"):
        train(small_config(tmp_path / "run", *DEMONSTRATED), make_points)


@pytest.mark.parametrize(
    ("demonstrator", "problem"),
    [
        ("random", "agent.demonstrator=random demonstrates nothing"),
        ("nobody", "agent.demonstrator=nobody: policy='nobody' is not there"),
    ],
)
def test_a_guide_that_cannot_guide_is_named(tmp_path, demonstrator, problem):
    config = small_config(
        tmp_path / "run",
        "task=pick_place",
        f"agent.demonstrator={demonstrator}",
        "agent.demonstrator_envs=2",
        "engine.num_envs=4",
    )
    with pytest.raises(ConfigError, match=problem):
        train(config)


@pytest.mark.parametrize("demonstrator", ["potential_field", "expert"])
def test_in_the_cell_a_guide_acts_for_the_first_rows(tmp_path, demonstrator):
    choices = (
        f"agent.demonstrator={demonstrator}",
        "agent.demonstrator_envs=2",
        "engine.num_envs=4",
        "agent.policy_steps=8",
    )
    config = small_config(tmp_path / "run", "task=pick_place", "comfort=conditioned", *choices)
    env = CellEnv(environment(config), 4, config.episode_seed)
    env.reset()
    episodes = env.engine.episodes
    act = make_policy(demonstrator, episodes.subtask, env.engine.scene, environment(config), 0)
    expected = act(episodes.state.rows(torch.arange(2)))
    assert expected.abs().max() > 0
    torch.testing.assert_close(make_demonstrator(config, env)(torch.arange(2)), expected)
    train(config)


def test_a_success_is_worth_what_the_successor_makes_of_it(tmp_path):
    choices = (
        "curriculum=off",
        "task.precision.grasp_tolerance_m=0.3",
        "agent.next_skill=next",
        "agent.gamma=0.5",
    )
    config = small_config(tmp_path, *choices)

    def next_skill(success: Tensor) -> Tensor:
        return success * 100.0

    rewards = []
    for value in (None, next_skill):
        env = PointEnv(8, 0)
        agent = replace(config.agent, next_skill=value and "next")
        collector = SkillCollector(agent, env, next_skill=value)
        training = Training(config, lambda _, made=collector: made, tmp_path)
        env.point[:4], env.point[4:] = 0.0, 0.9  # four are there at once
        training.step()
        rewards.append(training.learner.buffer.storage[:8]["next", "reward"][:, 0])
    expected = torch.zeros(8)
    expected[:4] = 100.0 * 0.5 ** env.rand_step()["next", "decision_steps"][0, 0]
    torch.testing.assert_close(rewards[1] - rewards[0], expected)
    with pytest.raises(ConfigError, match="this environment knows no next_skill"):
        train(small_config(tmp_path / "run", "agent.next_skill=next"), make_points)


def trained(folder: Path, task: str, *overrides: str) -> Path:
    choices = ("curriculum=off", "engine.num_envs=4", "agent.policy_steps=40", f"task={task}", *overrides)
    return train(small_config(folder, *choices))


def test_in_the_cell_the_successor_sees_what_it_would_begin_with(tmp_path):
    place = trained(tmp_path / "place", "place", "comfort=conditioned")
    config = small_config(
        tmp_path / "pick",
        "task=pick",
        "comfort=conditioned",
        "engine.num_envs=4",
        f"agent.next_skill={place}",
    )
    env = CellEnv(environment(config), 4, config.episode_seed)
    value_of = NextSkill(config).value(env)
    env.rollout(1)
    assert env.last is not None
    values = value_of(torch.tensor([True, False, True, False]))
    task = with_level(subtask("place", config.task.observation, 1), config.comfort.levels)
    expected = load_policy(place, critics=True).value(task.observe(env.last.state).float())
    torch.testing.assert_close(values[[0, 2]], expected[[0, 2]])
    assert values[[1, 3]].tolist() == [0.0, 0.0]


def test_a_demonstrator_for_another_task_is_named(tmp_path):
    pick = trained(tmp_path / "pick", "pick")
    with pytest.raises(ConfigError, match=r"agent\.demonstrator=.*was trained for 'pick', not for 'place'"):
        trained(tmp_path / "on", "place", f"agent.demonstrator='{pick}'", "agent.demonstrator_envs=2")


def test_a_successor_that_begins_elsewhere_is_named(tmp_path):
    pick = trained(tmp_path / "pick", "pick")
    for task, named, problem in (
        ("place", pick, "pick does not begin where place ends"),
        ("place", "nowhere", "nowhere: no such file"),
    ):
        with pytest.raises(ConfigError, match=problem):
            trained(tmp_path / "on", task, f"agent.next_skill={named}")


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
