"""Checkpoints and policy files: whole or refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import pytest
import torch

from hrl_comfort.agents import checkpoint
from hrl_comfort.agents.networks import Actor, Critics, Normaliser
from hrl_comfort.agents.sac import SAC
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError
from hrl_comfort.files.atomic import write_atomically
from hrl_comfort.files.provenance import step_files, step_path, unfinished
from hrl_comfort.files.state_file import FORMAT
from hrl_comfort.policies.actor import load_initial_policy, load_policy, policy_file, save_policy

SPEC = {
    "task": "pick",
    "observation_dim": 4,
    "action_dim": 2,
    "hidden": [8],
    "normalise": True,
    "environment": {"action_repeat": 5},
}


def write_policy(path: Path) -> tuple[Actor, Normaliser]:
    actor, normaliser = Actor(4, 2, [8]), Normaliser(4)
    normaliser.update(torch.randn(30, 4) * 3 + 1)
    save_policy(path, {"actor": actor.state_dict(), "normaliser": normaliser.state_dict()}, SPEC)
    return actor, normaliser


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def test_a_policy_file_acts_as_the_actor_it_was_saved_from(tmp_path):
    actor, normaliser = write_policy(tmp_path / "policy.pt")
    policy = load_policy(tmp_path / "policy.pt")
    observation = torch.randn(6, 4)
    assert torch.equal(policy(observation), actor.mode(normaliser(observation)))
    assert policy.spec == SPEC


def test_a_policy_refuses_observations_of_another_width(tmp_path):
    write_policy(tmp_path / "policy.pt")
    with pytest.raises(ConfigError, match="trained on 4 observations, got 9"):
        load_policy(tmp_path / "policy.pt")(torch.zeros(1, 9))


def test_a_policy_without_critics_acts_and_neither_values_nor_begins_a_training(tmp_path):
    agent = compose("train").agent
    learner, path = SAC(agent, 40, 6), tmp_path / "policy.pt"
    sizes = {"observation_dim": 40, "action_dim": 6, "hidden": list(agent.hidden)}
    for critics, most in ((True, 1e6), (False, 0.35e6)):
        save_policy(path, learner.policy_state(), {**SPEC, **sizes}, critics=critics)
        assert path.stat().st_size <= most
        assert load_policy(path)(torch.randn(3, 40)).shape == (3, 6)
    for use in (lambda: load_policy(path, critics=True), lambda: load_initial_policy(learner, path)):
        with pytest.raises(ConfigError, match=r"policy\.pt' was saved without its critics"):
            use()


@pytest.mark.parametrize("layer_norm", [False, True])
def test_the_value_of_a_policy_is_the_lower_critics_at_its_action(tmp_path, layer_norm):
    actor, normaliser, critics = Actor(4, 2, [8]), Normaliser(4), Critics(4, 2, [8], layer_norm)
    parts = {"actor": actor, "normaliser": normaliser, "critics": critics}
    save_policy(tmp_path / "policy.pt", {name: part.state_dict() for name, part in parts.items()}, SPEC)
    policy, observation = load_policy(tmp_path / "policy.pt", critics=True), torch.randn(6, 4)
    expected = critics(normaliser(observation), policy(observation)).amin(0)
    torch.testing.assert_close(policy.value(observation), expected.detach())


def test_a_training_begins_from_a_policy_of_its_own_kind_of_critics(tmp_path):
    agent, path = compose("train").agent, tmp_path / "policy.pt"
    sizes = {"observation_dim": 40, "action_dim": 6, "hidden": list(agent.hidden)}
    save_policy(path, SAC(replace(agent, critic_layer_norm=False), 40, 6).policy_state(), {**SPEC, **sizes})
    with pytest.raises(ConfigError, match="has critic_layer_norm=False, this training True"):
        load_initial_policy(SAC(agent, 40, 6), path)


@pytest.mark.parametrize("kind", ["cut", "text", "foreign", "pickle", "missing", "empty", "name"])
def test_a_bad_file_is_refused_in_one_line_that_names_it(tmp_path, kind):
    path = tmp_path / "policy.pt"
    write_policy(path)
    if kind == "cut":
        cut(path)
    elif kind == "text":
        path.write_text("not a policy\n")
    elif kind == "foreign":
        torch.save({"weights": torch.zeros(3)}, path)
    elif kind == "pickle":
        torch.save({"format": FORMAT, "path": tmp_path}, path)
    elif kind == "name":  # of an entry, no longer UTF-8
        with ZipFile(path, "w") as archive:
            archive.writestr("é", b"")
        path.write_bytes(path.read_bytes().replace("é".encode(), b"\xff\xff"))
    elif kind == "empty":
        path.write_bytes(b"")
    else:
        path.unlink()
    with pytest.raises(ConfigError, match=r"policy\.pt") as caught:
        load_policy(path)
    assert "\n" not in str(caught.value)


def test_a_spec_that_lacks_a_key_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="lacks hidden"):
        save_policy(tmp_path / "p.pt", {}, {k: v for k, v in SPEC.items() if k != "hidden"})


def test_a_failing_write_leaves_the_old_file_as_it_was(tmp_path):
    path = tmp_path / "x.pt"
    checkpoint.save(path, {"value": 1})

    def fail(file) -> None:
        file.write(b"half")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_atomically(path, fail)
    assert checkpoint.load(path)["value"] == 1


def test_only_the_newest_are_kept_in_order(tmp_path):
    for policy_steps in (5, 10, 200, 1000):
        checkpoint.save(step_path(tmp_path, policy_steps), {"policy_steps": policy_steps})
    checkpoint.save(tmp_path / "best.pt", {})
    checkpoint.keep_newest(tmp_path, 2)
    assert [p.name for p in step_files(tmp_path)] == ["step_000000200.pt", "step_000001000.pt"]
    assert (tmp_path / "best.pt").exists()


def test_files_of_others_are_no_checkpoints(tmp_path):
    (tmp_path / "provenance.json").write_text('{"finished": false}')
    for name in ("step_000000010.pt", "step_last.pt", "step_000000020 (copy).pt"):
        (tmp_path / "checkpoints").mkdir(exist_ok=True)
        (tmp_path / "checkpoints" / name).touch()
    assert "has 10 policy steps" in str(unfinished(tmp_path))


def test_a_truncated_newest_file_is_named_and_the_one_before_used(tmp_path):
    checkpoint.save_resumable(tmp_path, {"policy_steps": 1})
    checkpoint.save_resumable(tmp_path, {"policy_steps": 2})
    assert checkpoint.load_resumable(tmp_path)["policy_steps"] == 2
    cut(tmp_path / "latest.pt")
    with pytest.warns(UserWarning, match=r"latest\.pt"):
        assert checkpoint.load_resumable(tmp_path)["policy_steps"] == 1


@pytest.mark.parametrize("wrong", [{}, {"a": torch.zeros(2, dtype=torch.int8)}, {"a": torch.zeros(3)}, {"a": {"b": 0}}])
def test_a_content_of_other_keys_types_or_shapes_is_passed_over(wrong, tmp_path):
    checkpoint.save_resumable(tmp_path, {"a": torch.ones(2)})
    checkpoint.save_resumable(tmp_path, {"a": torch.zeros(2)})
    checkpoint.save(tmp_path / "latest.pt", {**checkpoint.load(tmp_path / "latest.pt"), "a": None, **wrong})
    with pytest.warns(UserWarning, match=r"latest\.pt: its content was changed"):
        assert checkpoint.load_resumable(tmp_path)["a"].tolist() == [1, 1]


def test_nothing_to_resume_from_is_an_error(tmp_path):
    with pytest.raises(ConfigError, match="no checkpoint to resume from"):
        checkpoint.load_resumable(tmp_path)


def test_a_run_folder_means_its_policy_or_else_its_newest_good_checkpoint(tmp_path):
    with pytest.raises(ConfigError, match="a run folder with a policy"):
        policy_file(tmp_path)
    for policy_steps in (10, 20):
        write_policy(step_path(tmp_path / "checkpoints", policy_steps))
    assert policy_file(tmp_path).name == "step_000000020.pt"
    cut(step_path(tmp_path / "checkpoints", 20))
    with pytest.warns(UserWarning, match="step_000000020"):
        assert policy_file(tmp_path).name == "step_000000010.pt"
    write_policy(tmp_path / "policy.pt")
    assert policy_file(tmp_path).name == "policy.pt"


def test_one_wrong_bit_is_found_by_the_checksums_of_the_file(tmp_path):
    path = tmp_path / "policy.pt"
    actor, _ = write_policy(path)
    weights = actor.state_dict()["body.0.weight"].numpy().tobytes()
    content = bytearray(path.read_bytes())
    content[content.index(weights)] ^= 1
    path.write_bytes(content)
    with pytest.raises(ConfigError, match="is not what its checksum says"):
        load_policy(path)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda state: state["networks"]["actor"]["body.0.weight"].mul_(1e38), "not always finite"),
        (lambda state: state["networks"]["normaliser"]["variance"].mul_(-1), "not always finite"),
        (lambda state: state["networks"]["normaliser"]["mean"].fill_(1e300), "mean is not finite"),
        (lambda state: state["networks"].update(actor=[]), "its actor is not there"),
        (lambda state: state["networks"]["actor"].update(large=torch.zeros(1).expand(10**5, 10**5)), "large is not"),
        (lambda state: state["networks"]["actor"].update(sparse=torch.zeros(3).to_sparse()), "sparse is not"),
        (lambda state: state["spec"].update(hidden=["8"]), "its spec is"),
        (lambda state: state["spec"].update(hidden=[10**6]), "is damaged"),
        (lambda state: state["spec"].update(normalise=torch.zeros(0)), "its normalise is not of type bool"),
        (lambda state: state["spec"].pop("task"), "its task is not of type str"),
    ],
)
def test_a_policy_with_something_else_in_it_is_refused(tmp_path, change, says):
    path = tmp_path / "policy.pt"
    write_policy(path)
    state = checkpoint.load(path)
    change(state)
    torch.save(state, path)
    with pytest.raises(ConfigError, match=says):
        load_policy(path)
