"""Cells shared out over processes: their episodes are those of one process, and the processes end with it."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from multiprocessing import active_children
from pathlib import Path

import numpy as np
import pytest
import torch

from hrl_comfort import environment_of
from hrl_comfort.agents import checkpoint
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EnvConfig, EvaluateConfig, TrainConfig
from hrl_comfort.envs.cells import Cells
from hrl_comfort.evaluation.evaluate import evaluate
from hrl_comfort.files.run_config import environment
from hrl_comfort.humans import split_set
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.processes.engine import make_engine
from hrl_comfort.tasks import State
from hrl_comfort.training.trainer import Training, train
from tests.stopping import stopping

SHIELDED = ["human=mixture", "safety=ssm", "robot.rating=collaborative", "task.terminate_on=unsafe_contact"]
NOISY = [
    "comfort=conditioned", "task.observation=sight", "randomise.joint_noise_deg=[0,0.1]",
    "randomise.link_mass=[0.9,1.1]",
]  # fmt: skip
WORLDS = {
    "kind": (["task=place", "comfort=conditioned", "randomise=sim_to_real"], 4, 2),
    "shielded": (["task=place", *SHIELDED, *NOISY], 7, 3),
}
"""World -> what configures it, rows and processes."""


def configured(*overrides: str) -> EnvConfig:
    return environment(compose("train", overrides))


def shared(config: EnvConfig, processes: int) -> EnvConfig:
    return replace(config, engine=replace(config.engine, processes=processes))


def starts(folder: Path) -> Path:
    """Write recorded starts, each with its person and its level."""
    bank = np.random.default_rng(0).normal(scale=0.05, size=(12, 21))
    bank[:, :6] += np.radians([0.0, -90.0, 90.0, -90.0, -90.0, 0.0])
    bank[:, 12:18] = bank[:, :6]
    bank[:, 18:] = [1.6, 0.9, 7.0]
    path = folder / "starts.npz"
    np.savez(path, orange=bank, pink=bank)
    return path


@contextmanager
def engines(config: EnvConfig, rows: int, processes: int) -> Iterator[tuple[Engine, Engine]]:
    """Yield the same cells in one process and in several."""
    made = [make_engine(shared(config, count), rows, 5) for count in (1, processes)]
    assert [type(each) is Engine for each in made] == [True, False]
    try:
        yield made[0], made[1]
    finally:
        for each in made:
            each.close()


def assert_same(mine: object, theirs: object) -> None:
    """Assert that values saved, or fields, are the same bit for bit."""
    assert type(mine) is type(theirs)
    if isinstance(mine, State):
        assert_same(mine.fields(), theirs.fields())  # type: ignore[attr-defined]
    elif isinstance(mine, dict):
        assert mine.keys() == theirs.keys()  # type: ignore[attr-defined]
        for name, value in mine.items():
            assert_same(value, theirs[name])  # type: ignore[index]
    elif isinstance(mine, list):
        for each, other in zip(mine, theirs, strict=True):  # type: ignore[call-overload]
            assert_same(each, other)
    elif isinstance(mine, torch.Tensor):
        torch.testing.assert_close(mine, theirs, rtol=0, atol=0, equal_nan=True)
    else:
        np.testing.assert_array_equal(mine, theirs)  # type: ignore[arg-type]


def run_beside(one: Engine, many: Engine, decisions: int) -> None:
    """Step both with the same actions and end episodes at random; assert that all that is known of them is the same."""
    rng, (rows, width) = np.random.default_rng(0), (one.num_envs, one.episodes.action_dim)
    for _ in range(decisions):
        action = rng.uniform(-1, 1, (rows, width))
        mine, theirs = one.step(action), many.step(action)
        for name, value in vars(mine).items():
            assert_same(value, getattr(theirs, name))
        assert_same(mine.human_distance, theirs.human_distance)
        assert_same(one.observe(), many.observe())
        assert_same(one.observe(), many.episodes.observe())
        ended = np.flatnonzero(mine.done.numpy() | (rng.random(rows) < 0.1))
        assert_same(one.reset(ended), many.reset(ended))


@pytest.mark.parametrize("world", WORLDS)
def test_episodes_are_those_of_one_process(world: str, tmp_path: Path) -> None:
    overrides, rows, processes = WORLDS[world]
    with engines(configured(*overrides, f"task.start='{starts(tmp_path)}'"), rows, processes) as (one, many):
        assert_same(one.reset(), many.reset())
        run_beside(one, many, 25)
        for each in (one, many):  # as a curriculum does
            each.episodes.precision_m, each.episodes.sampler.reach = 0.02, 0.5
        run_beside(one, many, 10)
        saved = one.state_dict()
        assert_same(saved, many.state_dict())
        for each in (one, many):
            each.episodes.rewind(9)
            each.reset()
            each.load_state_dict(saved)
        run_beside(one, many, 5)
        entries = split_set("validation", rows).at(np.arange(rows)[::-1])
        assert_same(one.reset(entries=entries), many.reset(entries=entries))
        run_beside(one, many, 5)


def test_some_rows_are_stepped_while_others_are_held_and_targets_are_chosen() -> None:
    with engines(configured("task=sort", "human=patrol"), 5, 2) as (one, many):
        assert_same(one.reset(), many.reset())
        held, rows = torch.tensor([1, 3, 4]), np.array([0, 2])
        for index in (1, 0, 1):
            for each in (one, many):
                each.episodes.aim(torch.arange(5), torch.full((5,), index))
                with each.held(held):
                    result = each.step(np.full((5, 6), 0.3), rows)
                assert result.decision_steps[rows].tolist() == [5, 5]
            assert_same(one.episodes.state, many.episodes.state)
            assert_same(one.physics_state, many.physics_state)
        copies = [each.copies(torch.tensor([4, 0])) for each in (one, many)]
        assert_same(*(each.step(np.ones((2, 6))).state for each in copies))


def test_mistakes_are_those_of_one_process_and_a_process_that_ends_is_named() -> None:
    with engines(configured("task=reach"), 4, 2) as (one, many):
        for each in (one, many):
            with pytest.raises(RuntimeError, match="call reset before step"):
                each.step(np.ones((4, 6)))
            with pytest.raises(ConfigError, match="the first reset must reset every row"):
                each.reset(np.array([0, 1]))
            each.reset()
            with pytest.raises(ValueError, match=r"must have shape \(4, 6\)"):
                each.step(np.ones((2, 6)))
            with pytest.raises(ValueError, match="name at least one row"):
                each.step(np.ones((4, 6)), np.array([], dtype=np.int64))
            each.episodes.precision_m = 10.0  # wherever the arm is, it has arrived
            with pytest.raises(ConfigError, match=r"no free start for reach in rows \[3\] after") as error:
                each.reset(np.array([3]))
            assert "\n" not in str(error.value)
            each.episodes.rewind()
            with pytest.raises(RuntimeError, match="call reset before step"):
                each.step(np.ones((4, 6)))
        active_children()[0].kill()
        with pytest.raises(ChildProcessError, match=r"of engine\.processes=2, ended with exit code -9;"):
            many.observe()
        with pytest.raises(ChildProcessError, match=r"of engine\.processes=2, ended with exit code -9;"):
            many.observe()
    assert not active_children()


PARENT = """
import multiprocessing, os, signal, sys
from tests.sim.test_processes import configured, make_engine, shared
engine = make_engine(shared(configured("task=reach"), 2), 2, 0)
print(*(each.pid for each in multiprocessing.active_children()), flush=True)
if sys.argv[1] == "killed":
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize("way", ["killed", "at its end"])
def test_processes_end_with_their_parent(way: str) -> None:
    with subprocess.Popen([sys.executable, "-c", PARENT, way], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pids = [int(word) for word in parent.stdout.readline().split()]
        assert len(pids) == 2
        for pid in pids:
            with suppress(ProcessLookupError):
                ended = os.pidfd_open(pid)
                assert select.select([ended], [], [], 180.0)[0]
                os.close(ended)
        assert parent.wait(180.0) == (-signal.SIGKILL if way == "killed" else 0)


def test_a_training_is_that_of_one_process_and_resumes(tmp_path: Path) -> None:
    def small(name: str, *overrides: str) -> TrainConfig:
        stages = "[{name: near, policy_steps: 120, set: {}}, {name: far, policy_steps: 120, set: {reward.pick: 20}}]"
        config = compose("train", [
            "task=pick", "agent.learning_starts=40", "agent.hidden=[8]", "agent.batch_size=16", "agent.log_every=40",
            "agent.checkpoint_every=40", "engine.num_envs=5", "task.max_episode_steps=40", "human=arc",
            "agent.demonstrator=potential_field", "agent.demonstrator_envs=2", f"curriculum.stages={stages}",
            f"output='{tmp_path / name}'", *overrides,
        ])  # fmt: skip
        assert isinstance(config, TrainConfig)
        return config

    one = train(small("one"))
    with stopping(Training, "step", lambda training: training.steps >= 160):
        train(small("two", "engine.processes=2"))
    two = train(small("unused", f"resume='{tmp_path / 'two'}'"))
    assert (one / "metrics.csv").read_bytes() == (two / "metrics.csv").read_bytes()
    assert_same(*(checkpoint.load(folder / "policy.pt")["networks"] for folder in (one, two)))
    assert not active_children()


@pytest.mark.parametrize("world", WORLDS)
def test_an_evaluation_is_that_of_one_process(world: str, tmp_path: Path) -> None:
    overrides, episodes, processes = {
        "kind": (["task=pick", "policy=potential_field", "human=random_walk"], 4, 2),
        "shielded": (
            ["task=cycle", "meta_controller=nearest", *SHIELDED, *NOISY, "split=validation",
             *(f"policies.{skill}=potential_field" for skill in ("pick", "place", "return"))], 7, 3,
        ),
    }[world]  # fmt: skip
    folders = []
    for count in (1, processes):
        config = compose("evaluate", [
            *overrides, f"episodes={episodes}", "record=true", "task.max_episode_steps=300", "levels=[2]",
            f"engine.processes={count}", f"output='{tmp_path / str(count)}'",
        ])  # fmt: skip
        assert isinstance(config, EvaluateConfig)
        folders.append(evaluate(config))
    for file in ("episodes.csv", "paths.csv", "options.csv", "summary.json"):
        one, several = ((folder / file).read_bytes() for folder in folders)
        assert one == several, file


def test_what_one_process_alone_can_do_is_refused_before_anything_is_built() -> None:
    assert type(make_engine(shared(configured("task=reach"), 4), 1, 0)) is Engine, "at most one for each cell"
    with pytest.raises(ConfigError, match=r"engine\.processes=2 is for train, evaluate.* choose engine\.processes=1"):
        Cells(shared(environment_of("reach"), 2), 3)
    for live in ("human=live", "comfort.source=udp"):
        with pytest.raises(ConfigError, match=r"engine\.processes=2 does not go with .*choose engine\.processes=1"):
            configured("comfort=conditioned", live, "engine.processes=2")
