"""Disturbances, and recovery from them by meta-controllers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig, MetaControllerTrainConfig
from hrl_comfort.evaluation.rollout import Result, rollout
from hrl_comfort.files.run_config import environment, load_config, save_config
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.variation.disturbance import BLOCK_STEPS


def measured(*overrides: str) -> Result:
    config = compose("evaluate", ["meta_controller=nearest", "human=none", "episodes=4", *overrides])
    assert isinstance(config, EvaluateConfig)
    return rollout(replace(config, policies=dict.fromkeys(config.meta_controller.options, "expert")))


@pytest.mark.parametrize("overrides", [("task=cycle",), ("task=sort", "task.objects=2")])
def test_an_object_that_is_lost_is_picked_again(overrides: tuple[str, ...]) -> None:
    result = measured(*overrides, "disturbance=drop")
    went_home: list[bool] = []
    for episode in result.episodes:
        runs = [run for run in result.options if run["episode"] == episode.episode]
        lost = [run["termination"] for run in runs].index("preempted")
        assert runs[lost]["option"] == "place"
        after = runs[lost + 1 :]
        went_home.append(after[0]["option"] == "retreat")
        again = after[1] if went_home[-1] else after[0]
        assert again["option"].startswith("pick") and again["termination"] == "success"
    assert any(went_home) == ("task=sort" in overrides)  # any: some lose it as they pass home


def test_a_policy_for_the_whole_task_loses_its_object_too() -> None:
    config = compose("evaluate", ["task=pick_place", "policy=expert", "human=none", "episodes=4"])
    calm, disturbed = (rollout(replace(config, disturbance=kind)).episodes for kind in ("none", "drop"))
    done = [(b, a) for b, a in zip(calm, disturbed, strict=True) if a.success]
    assert done and all(after.steps > before.steps for before, after in done)


def test_a_person_blocks_the_place_of_the_first_object_and_then_wanders() -> None:
    config = environment(compose("train", ["task=cycle", "human=random_walk"]))
    engine = Engine(config, 6, 0, disturbance="block")
    state = engine.reset()
    apart = (state.humans_pos[:, 0] - state.target_place[:, :2]).norm(dim=-1)
    torch.testing.assert_close(apart, torch.full_like(apart, config.human.keep_out_m), atol=1e-4, rtol=0)
    stand = torch.zeros_like(state.joint_pos).numpy()
    here, left = state.humans_pos[:, 0], torch.zeros(6, dtype=torch.bool)
    for _ in range(BLOCK_STEPS // 5 + 4):
        outcome = engine.step(stand)
        standing = outcome.state.steps <= BLOCK_STEPS
        moved = (outcome.state.humans_pos[:, 0] - here).norm(dim=-1) > 1e-9
        assert not (moved & standing).any()
        left |= moved
    assert left.all()


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["task=place", "disturbance=drop"], "needs an object that is picked and then placed"),
        (["task=cycle", "disturbance=block", "human=none"], "needs a human"),
        (["task=cycle", "disturbance=drop", "terminal_states=e.npz"], "does not go with terminal_states="),
    ],
)
def test_a_disturbance_that_cannot_happen_is_refused(overrides: list[str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        compose("evaluate", overrides)


def test_an_unknown_disturbance_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"disturbance='flood'.*drop"):
        compose("evaluate", ["disturbance=flood"])


def test_a_controller_above_a_hand_is_not_trained_with_objects_that_fall_off_a_tool() -> None:
    with pytest.raises(ConfigError, match="disturbance=drop is for objects that ride on the tool"):
        compose("train_meta_controller", ["cell=bench_hand", "output=unused"])


def test_a_training_above_a_hand_of_an_earlier_version_is_read_without_objects_that_fall(tmp_path: Path) -> None:
    file = tmp_path / "config.yaml"
    save_config(compose("train_meta_controller", ["cell=bench_hand", "disturbance=none"]), file)
    file.write_text(
        file.read_text(encoding="utf-8").replace("disturbance: none", "disturbance: drop"), encoding="utf-8"
    )
    config = load_config(tmp_path)
    assert isinstance(config, MetaControllerTrainConfig) and config.disturbance == "none"
