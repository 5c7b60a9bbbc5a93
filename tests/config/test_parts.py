"""Comfort forms, tasks and humans of other packages: by `package.module:name` and by entry point."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

import hrl_comfort
from hrl_comfort.comfort.terms import distance_term
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.config.checks import implemented, plugins
from hrl_comfort.config.commands import PICK_AND_PLACE
from hrl_comfort.config.overrides import check_overrides, choices
from hrl_comfort.files.run_config import is_same, load_config, save_config
from hrl_comfort.humans import MOTIONS
from hrl_comfort.scene.robots import ROBOTS
from hrl_comfort.sim.engine import Engine
from hrl_comfort.tasks import SUBTASKS, subtask

MODULE = """
from hrl_comfort.tasks import SUBTASKS

def hinge(distance, theta, config):
    return -(theta - distance).clamp(min=0)

def march(config, walk, noise, tcp):
    return walk.position + [0.0, 0.01], walk.yaw

GO = SUBTASKS["pick"]
"""
ENTRY_POINTS = """
[hrl_comfort.task.name]
go = thing:GO
[hrl_comfort.human.motion]
march = thing:march
[hrl_comfort.comfort.form]
hinge = thing:hinge
"""


@pytest.fixture(autouse=True)
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Install the package `thing`, which names its parts with entry points."""
    (tmp_path / "thing.py").write_text(MODULE, encoding="utf-8")
    info = tmp_path / "thing-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: thing\nVersion: 1.0\n", encoding="utf-8")
    (info / "entry_points.txt").write_text(ENTRY_POINTS, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    plugins.cache_clear()
    yield
    sys.modules.pop("thing", None)
    plugins.cache_clear()


def test_a_registry_has_a_part_for_every_name_that_the_configuration_allows() -> None:
    assert list(implemented(("b", "a"), {"a": 1, "b": 2})) == ["b", "a"]
    for parts in ({"a": 1}, {"a": 1, "b": 2, "c": 3}):
        with pytest.raises(LookupError, match=r"^[bc]: the configuration allows a, b$"):
            implemented(("a", "b"), parts)


def test_every_choice_of_a_group_of_parts_exists() -> None:
    for group, registry in {"task": SUBTASKS, "human": {*MOTIONS, "mixture", "pair"}, "robot": ROBOTS}.items():
        assert set(choices(group)) == set(registry), group


def test_tasks_that_pick_and_place_have_both_stages() -> None:
    stages = {name: {stage.name for stage in each.stages} for name, each in SUBTASKS.items()}
    assert {name for name, there in stages.items() if {"pick", "place"} <= there} == set(PICK_AND_PLACE)


NAMES = [("thing:GO", "thing:march", "thing:hinge"), ("go", "march", "hinge")]


@pytest.mark.parametrize(("task", "human", "form"), NAMES, ids=["module", "entry_point"])
def test_parts_of_another_package_make_an_environment(task: str, human: str, form: str, tmp_path: Path) -> None:
    choices = [f"task={task}", f"human={human}", "comfort=conditioned", f"comfort.form={form}", "human.keep_out_m=0"]
    config = compose("train", [*choices, "engine.num_envs=2"])
    assert isinstance(config, TrainConfig)
    assert (config.task.name, config.human.motion, config.comfort.form) == (task, human, form)
    save_config(config, tmp_path / "config.yaml")
    assert is_same(load_config(tmp_path), config)

    assert subtask(task).name == task
    near, theta = torch.tensor([0.3, 2.0]), distance_term(torch.zeros(1), torch.ones(1), config.comfort)
    np.testing.assert_allclose(distance_term(near, torch.ones(2), config.comfort), [0.3 + theta.item(), 0.0])

    engine = Engine(config, 2, seed=0)
    before = engine.reset().humans_pos[:, 0].numpy().copy()
    after = engine.step(np.zeros((2, 6))).state
    np.testing.assert_allclose(after.humans_pos[:, 0].numpy() - before, [[0.0, 0.01 * 5]] * 2, atol=1e-9)
    engine.close()


def test_a_part_is_loaded_by_name_from_python() -> None:
    assert "level" not in hrl_comfort.load("thing:GO", human="march").reset().observation


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("task=nothing:GO", "task.name='nothing:GO' cannot be imported: No module named 'nothing'"),
        ("task=thing:hinge", "task.name='thing:hinge' is of type function; it must be a Subtask"),
        ("human=thing:nobody", "human.motion='thing:nobody': .*thing.py has no nobody"),
        ("human=thing:__name__", "human.motion='thing:__name__' is of type str; it must be a function"),
        ("comfort.form=thing:__name__", "comfort.form='thing:__name__' is of type str; it must be a function"),
        ("comfort.form=thing:nothing", "comfort.form='thing:nothing': .*thing.py has no nothing"),
        ("comfort.form=square", "comfort.form='square' is not allowed; choose one of paper, .*, hinge, or package.mod"),
        ("task=grab", "task=grab is not a choice; choose one of cycle, "),
    ],
)
def test_a_part_that_is_not_there_gets_one_line(override: str, message: str) -> None:
    key, value = override.split("=")
    with pytest.raises(ConfigError, match=f"^{message}"):
        hrl_comfort.load(**{"task": "pick", "comfort": "conditioned", key: value}).reset()  # type: ignore[arg-type]


def test_parts_of_other_packages_are_swept_apart_from_ours() -> None:
    swept = check_overrides("train", ["task=go,thing:GO"], sweep=True)
    assert swept == ["task.name=go,thing:GO"]
    with pytest.raises(ConfigError, match=r"^task=pick,go mixes go with .*, or sweep task\.name=pick,go$"):
        check_overrides("train", ["task=pick,go"], sweep=True)
