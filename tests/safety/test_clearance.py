"""A rated arm keeps clear of what stands there and of itself, whatever it is asked for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from hrl_comfort.composition.compose import compose_environment
from hrl_comfort.config import ConfigError
from hrl_comfort.safety.clearance import Clearance
from hrl_comfort.safety.geometry import ArmGeometry
from hrl_comfort.scene.workcell import build_scene
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.variation.layouts import tops

RATED = ["robot.rating=collaborative", "task=cycle", "human=none"]


class Numpy(np.ndarray[Any, Any]):
    """Arrays for which the kernels' definitions are taken."""


def collisions(rows: int, decisions: int, *words: str) -> int:
    """Return the collisions under directions that are held for a while."""
    engine = Engine(compose_environment("train", [*RATED, *words]), rows, 0)
    engine.reset()
    draws, found = torch.Generator().manual_seed(0), 0
    for decision in range(decisions):
        if decision % 8 == 0:
            action = torch.rand(rows, engine.episodes.action_dim, generator=draws).mul(2).sub(1).sign()
        result = engine.step(action.numpy())
        found += int((result.state.table_collision | result.state.self_collision).sum())
        if (done := result.done.nonzero()[:, 0].numpy()).size:
            engine.reset(done)
    return found


@pytest.mark.parametrize("more", [["cell=paper"], ["cell=bench"], ["cell=station", "robot=ur10e"]])
def test_an_arm_that_keeps_a_clearance_runs_into_nothing(more: list[str]) -> None:
    assert collisions(32, 60, *more) > 0
    assert collisions(32, 60, *more, "safety.clearance_m=0.01") == 0


@pytest.mark.parametrize("robot", ["ur3e", "ur10e"])
def test_the_kernel_finds_what_its_definition_finds(robot: str) -> None:
    config = compose_environment("train", [*RATED, f"robot={robot}", "cell=bench"])
    scene = build_scene(config.robot, config.cell, config.substeps)
    clearance, rng = Clearance(scene, ArmGeometry(scene), 0.03), np.random.default_rng(0)
    begin = rng.uniform(*scene.joint_range.T, (400, 6))
    end = begin + rng.normal(0, 0.1, begin.shape)
    standing: NDArray[np.float64] = np.tile(
        tops(config.cell, *np.split(scene.layout, [len(config.cell.places)])), (400, 1, 1)
    )
    standing[:, :, :2] += rng.normal(0, 0.1, (400, 1, 2))
    found = clearance.keeps(begin, end, standing)
    defined = clearance.keeps(begin.view(Numpy), end.view(Numpy), standing.view(Numpy))
    assert (found == np.asarray(defined)).all() and 50 < found.sum() < 395


def test_what_is_far_from_everything_is_let_through_as_it_is() -> None:
    actions = torch.rand(20, 8, 6, generator=torch.Generator().manual_seed(1)).mul(0.4).sub(0.2).numpy()
    paths = []
    for clearance in ("null", "0.01"):
        engine = Engine(compose_environment("train", [*RATED, f"safety.clearance_m={clearance}"]), 8, 0)
        engine.reset()
        paths.append([engine.step(action).state.joint_pos.numpy() for action in actions[:5]])
    np.testing.assert_array_equal(*paths)


def test_a_hand_keeps_no_clearance_from_what_it_takes_objects_from() -> None:
    config = compose_environment("train", [*RATED, "cell=grasp", "safety.clearance_m=0.01"])
    with pytest.raises(
        ConfigError, match=r"safety\.clearance_m=0\.01 does not go with robot\.gripper\.name=two_finger"
    ):
        Engine(config, 1, 0)


def test_an_arm_that_cannot_brake_keeps_no_clearance() -> None:
    config = compose_environment("train", ["task=pick", "safety.clearance_m=0.01"])
    with pytest.raises(ConfigError, match=r"safety\.clearance_m=0\.01 needs an arm that brakes within its rating"):
        Engine(config, 1, 0)


def test_the_kernel_damps_as_its_definition_does() -> None:
    config = compose_environment("train", [*RATED, "cell=bench"])
    scene = build_scene(config.robot, config.cell, config.substeps)
    clearance, rng = Clearance(scene, ArmGeometry(scene), 0.02), np.random.default_rng(0)
    angles, asked = rng.uniform(*scene.joint_range.T, (300, 6)), rng.normal(0, 1.0, (300, 6))
    standing = np.tile(tops(config.cell, *np.split(scene.layout, [len(config.cell.places)])), (300, 1, 1))
    found = clearance.damped(angles, asked, standing)
    defined = clearance.damped(angles.view(Numpy), asked.view(Numpy), standing.view(Numpy))
    np.testing.assert_allclose(found, np.asarray(defined), rtol=0, atol=1e-9)
    assert (found == asked).all(axis=1).any() and (found != asked).any(axis=1).any()
