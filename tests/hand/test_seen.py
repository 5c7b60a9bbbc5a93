"""A hand is seen and exported: the studio, ONNX files, data sets and reports know fingers, objects and drops."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import minari
import mujoco
import numpy as np
import pytest
import torch
from pandas import DataFrame

from hrl_comfort.analysis.episodes import terminations
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import EvaluateConfig, ExportConfig, GripperConfig, StudioConfig, TrainConfig
from hrl_comfort.deploy.dataset import dataset
from hrl_comfort.deploy.export import export
from hrl_comfort.evaluation.evaluate import evaluate
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.plots.clip import set_pose
from hrl_comfort.policies.load import make_policy
from hrl_comfort.report.report import report
from hrl_comfort.sim.engine import Engine
from hrl_comfort.studio.session import Session
from hrl_comfort.training.trainer import train

ALONE = ("cell=grasp", "human=none", "task.object_jitter_m=0.07")


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the run of a policy with a hand that has hardly been trained."""
    small = (
        "engine.num_envs=4", "agent.policy_steps=64", "agent.learning_starts=32", "agent.hidden=[8]",
        "agent.batch_size=8",
    )  # fmt: skip
    output = tmp_path_factory.mktemp("run") / "pick"
    config = compose("train", [*ALONE, "task=pick", *small, f"output='{output}'"])
    assert isinstance(config, TrainConfig)
    return train(config)


@pytest.mark.parametrize("gripper", ["two_finger", "robotiq_2f85"])
def test_the_studio_shows_what_the_fingers_do_and_where_objects_fall(gripper: str) -> None:
    words = [*ALONE, "task=place", "task.object=cube", "policy=expert", f"gripper={gripper}"]
    config = compose("studio", words)
    assert isinstance(config, StudioConfig)
    session = Session(config)
    scene, data = session.engine.scene, mujoco.MjData(session.engine.scene.model)

    def shown(clip, time_s: float) -> tuple[np.ndarray, float]:
        set_pose(data, scene, clip.frame(time_s))
        pads = [data.body(f"robot/{name}").xpos.copy() for name in scene.gripper.pads]
        return data.body("object_1_cube").xpos.copy(), float(np.linalg.norm(pads[0] - pads[1]))

    held, closed = shown(session.still(), 0.0)
    assert held == pytest.approx(session.state.objects[0, 0].numpy(), abs=1e-6)
    session.action = torch.tensor([[0.0] * 6 + [-1.0]], dtype=torch.float64)
    for _ in range(4):
        step = session.step()
        session.action = torch.tensor([[0.0] * 6 + [-1.0]], dtype=torch.float64)
    fallen, opened = shown(step.clip, step.clip.duration_s)
    assert opened > closed + 0.02
    assert fallen[2] < held[2] - 0.05
    assert fallen == pytest.approx(session.state.objects[0, 0].numpy(), abs=0.01)
    between, _ = shown(step.clip, step.clip.duration_s / 2)
    assert np.isfinite(between).all()
    session.close()


def test_an_exported_policy_moves_six_joints_and_the_fingers(trained: Path, tmp_path: Path) -> None:
    config = compose("export", [f"policy={trained}", f"output={tmp_path / 'out'}"])
    assert isinstance(config, ExportConfig)
    folder = export(config)
    made = json.loads((folder / "policies.json").read_text(encoding="utf-8"))
    assert len(made["joint_names"]) == len(made["joint_limits_rad"]) == 6
    assert made["gripper"] == {"name": "two_finger", "open": 0.0, "closed": 0.0435, "closing_s": 0.2}
    (option,) = made["options"]
    assert (
        option["joints"] == 6 and option["gripper"] == "two_finger" and "fingers" in option["output"]["joint_increment"]
    )
    engine = Engine(config, 3, 0)
    state, task = engine.reset(), engine.episodes.subtask
    own, other = (
        make_policy(source, task, engine.scene, config, 0) for source in (str(trained), f"onnx:{folder}/pick.onnx")
    )
    for _ in range(5):
        action = own(state)
        assert action.shape == (3, 7)
        torch.testing.assert_close(other(state), action, rtol=0, atol=1e-4, check_dtype=False)
        state = engine.step(action.numpy()).state


def test_a_data_set_has_the_seventh_action_and_tells_drops(tmp_path: Path) -> None:
    words = [*ALONE, "task=place", "policy=expert", "episodes=3", "split=validation", f"output={tmp_path / 'data'}"]
    config = compose("evaluate", words)
    assert isinstance(config, EvaluateConfig)
    data = minari.MinariDataset(dataset(config) / "data")
    assert data.action_space.shape == (7,)
    for episode in data.iterate_episodes():
        assert episode.infos["success"][-1] and set(episode.infos["drops"]) == {0}
        assert not np.any(episode.infos["object_lost"])


def test_an_episode_that_runs_out_of_time_after_a_drop_ended_with_that() -> None:
    common = {"success": False, "contact": False, "unsafe_contact": False, "other_collision": "none"}
    rows = [{"drops": 1, "object_lost": False}, {"drops": 1, "object_lost": True}, {"drops": 0, "object_lost": False}]
    episodes = DataFrame([{**common, **row, "truncated": not row["object_lost"]} for row in rows])
    assert terminations(episodes).tolist() == ["dropped", "object lost", "time limit"]


def test_how_far_an_object_shifts_in_the_hand_is_told() -> None:
    words = [*ALONE, "task=pick", "policy=expert", "episodes=4", "split=validation", "output=unused"]
    config = compose("evaluate", words)
    assert isinstance(config, EvaluateConfig)
    table = rollout(config).table
    assert table["success"].all() and table["slip_mm"].between(0, 15).all() and (table["slip_mm"] > 0).any()
    assert rollout(replace(config, robot=replace(config.robot, gripper=GripperConfig()))).table["slip_mm"].isna().all()


def test_a_report_lists_what_was_dropped_among_the_failures(tmp_path: Path) -> None:
    words = [*ALONE, "task=place", f"policy={__name__}:let_go", "episodes=2", "split=validation"]
    config = compose("evaluate", [*words, "task.max_episode_steps=60", f"output={tmp_path / 'run' / 'eval'}"])
    assert isinstance(config, EvaluateConfig)
    evaluate(config)
    page = report(compose("report", [f"run={tmp_path / 'run'}"])).read_text(encoding="utf-8")  # type: ignore[arg-type]
    assert ">drops</th>" in page and ">slip (mm)</th>" in page and ">dropped</td>" in page


def let_go(observation: np.ndarray) -> np.ndarray:
    """Open the hand and stand still."""
    action = np.zeros((len(observation), 7))
    action[:, 6] = -1.0
    return action
