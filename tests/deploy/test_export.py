"""An exported policy is the policy: the same increments from named quantities, the same episodes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig, ExportConfig
from hrl_comfort.deploy.export import export
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.policies.actor import load_policy
from hrl_comfort.policies.graph import arguments, field_meanings, read_onnx
from hrl_comfort.policies.load import observed_by
from hrl_comfort.sim.engine import Engine
from hrl_comfort.tasks import State

REFERENCE = Path("runs/reference")
CHAIN = ("pick", "place", "return")


def exported(output: Path, *overrides: str) -> Path:
    config = compose("export", [*overrides, f"output={output}"])
    assert isinstance(config, ExportConfig)
    return export(config)


def evaluated(*overrides: str) -> EvaluateConfig:
    config = compose("evaluate", ["episodes=10", "split=validation", *overrides])
    assert isinstance(config, EvaluateConfig)
    return config


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the exported chain of reference policies."""
    return exported(tmp_path_factory.mktemp("export"), *(f"policies.{name}={REFERENCE / name}" for name in CHAIN))


def test_an_export_replaces_its_own_files_and_refuses_those_of_others(tmp_path: Path) -> None:
    word = f"policy={REFERENCE / 'pick'}"
    for _ in range(2):
        exported(tmp_path / "own", word)
    assert {each.name for each in (tmp_path / "own").iterdir()} == {
        "config.yaml", "pick.onnx", "pick.pt2", "policies.json"
    }  # fmt: skip
    (tmp_path / "policies.json").write_text("of somebody else")
    with pytest.raises(ConfigError, match="holds other files"):
        exported(tmp_path, word)


@pytest.mark.parametrize("option", CHAIN)
def test_onnx_gives_the_increments_of_torch_in_states_of_real_episodes(folder: Path, option: str) -> None:
    config = evaluated(f"policy={REFERENCE / option}")
    policy, engine = load_policy(REFERENCE / option), Engine(config, 100, 0)
    task = observed_by(policy, str(REFERENCE / option), engine.episodes.subtask, config)
    about = next(
        each for each in json.loads((folder / "policies.json").read_text())["options"] if each["task"] == option
    )
    session = onnxruntime.InferenceSession(folder / about["file"])
    state = engine.reset()
    for _ in range(10):
        actions = policy(task.observe(state))
        given = dict(zip(about["inputs"], (each.numpy() for each in arguments(state, about["inputs"])), strict=True))
        (increments,) = session.run(None, given)
        np.testing.assert_allclose(increments, np.radians(2.0) * actions.numpy(), atol=1e-5)
        state = engine.step(actions.double().numpy()).state


def test_episodes_are_the_same_one_by_one(folder: Path) -> None:
    chain = ("task=cycle", "meta_controller=nearest")
    ours = rollout(evaluated(*chain, *(f"policies.{name}={REFERENCE / name}" for name in CHAIN))).table
    theirs = rollout(evaluated(*chain, *(f"policies.{name}=onnx:{folder / name}.onnx" for name in CHAIN))).table
    assert list(ours["success"]) == list(theirs["success"])
    assert list(ours["steps"]) == list(theirs["steps"])


def test_the_archive_beside_it_needs_torch_alone(folder: Path) -> None:
    code = (
        "import sys, torch; program = torch.export.load(sys.argv[1]).module();"
        "rows = [torch.zeros(3, *n) for n in ((6,), (6,), (3,), (6,), (1, 2), (3,))];"
        "print(tuple(program(*rows).shape));"
        "assert not any(name.startswith('hrl_comfort') for name in sys.modules)"
    )
    shown = subprocess.run(
        [sys.executable, "-c", code, folder / "pick.pt2"], capture_output=True, text=True, cwd=folder
    )
    assert shown.stdout.strip() == "(3, 6)", shown.stderr


def test_an_export_beside_one_person_sees_the_nearest_of_several(folder: Path) -> None:
    engine = Engine(evaluated("task=pick", "human=pair", f"policy={REFERENCE / 'pick'}"), 20, 0)
    state, policy = engine.reset(), read_onnx(f"onnx:{folder / 'pick.onnx'}")
    nearest = (state.humans_pos - state.tcp_pos[:, None, :2]).norm(dim=-1).argmin(dim=1)
    assert set(nearest.tolist()) == {0, 1}
    trained = load_policy(REFERENCE / "pick")
    expected = trained(engine.episodes.subtask.observe(state)).double()
    np.testing.assert_allclose(policy(state).numpy(), expected.numpy(), atol=1e-4)


def test_inputs_of_earlier_exports_are_those_of_one_person(folder: Path) -> None:
    state = Engine(evaluated("task=pick", f"policy={REFERENCE / 'pick'}"), 3, 0).reset()
    seen, shown, yaw = arguments(state, ["human_seen", "human_shown", "human_yaw"])
    assert torch.equal(seen, state.humans_seen[:, 0].float()) and yaw.shape == shown.shape == (3,)


def test_a_policy_of_levels_says_so(tmp_path: Path) -> None:
    policy = REFERENCE / "comfort/stages/seed0"
    exported(tmp_path, f"policy={policy}")
    (about,) = json.loads((tmp_path / "policies.json").read_text())["options"]
    assert about["levels"] == 10
    assert {"level", "stage"} <= about["inputs"].keys()
    level = ("comfort.source=fixed", "comfort.level=10", "task=pick_place")
    source = f"policy=onnx:{tmp_path / 'pick_place.onnx'}"
    ours = rollout(evaluated(f"policy={policy}", *level)).table
    theirs = rollout(evaluated(source, *level, "human.spawn_radius_m=[0.38,1.3]", *as_trained(policy))).table
    assert list(ours["steps"]) == list(theirs["steps"])
    with pytest.raises(ConfigError, match=r"comfort.source=none, but policy='onnx:.*' needs a comfort level"):
        rollout(evaluated(source, "task=pick_place"))


def as_trained(policy: Path) -> list[str]:
    task = evaluated(f"policy={policy}").task.precision
    return [f"task.precision.{name}={value}" for name, value in vars(task).items()]


def test_every_quantity_of_the_state_is_explained() -> None:
    assert set(State.__dataclass_fields__) < set(field_meanings())


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["policy=expert"], "policy='expert': export takes a run folder"),
        ([], "policy=None policies={}: give one of the two"),
        ([f"policy={REFERENCE / 'pick'}", "task.action=cartesian"], "task.action=cartesian: only policies of joint"),
        (["policies.place=runs/reference/pick"], "was trained for 'pick', not for 'place'"),
    ],
)
def test_what_cannot_be_exported_is_refused_in_one_line(tmp_path: Path, overrides: list[str], message: str) -> None:
    with pytest.raises(ConfigError) as refused:
        exported(tmp_path / "out", *overrides)
    assert message in str(refused.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "there is no file"), (b"", "is not an ONNX file"), (b"\x08\x07garbage", "is not an ONNX file")],
)
def test_a_damaged_file_gets_one_line(tmp_path: Path, content: bytes | None, message: str) -> None:
    if content is not None:
        (tmp_path / "pick.onnx").write_bytes(content)
    with pytest.raises(ConfigError, match=message):
        rollout(evaluated(f"policy=onnx:{tmp_path / 'pick.onnx'}"))


def test_one_policy_for_another_task_or_robot_is_refused(folder: Path) -> None:
    source = f"policy=onnx:{folder / 'pick.onnx'}"
    with pytest.raises(ConfigError, match="was trained for 'pick', not for 'place'"):
        rollout(evaluated(source, "task=place"))
    with pytest.raises(ConfigError, match=r"robot=ur5e, but policy='onnx:.*' was trained with robot=ur3e"):
        rollout(evaluated(source, "robot=ur5e"))
