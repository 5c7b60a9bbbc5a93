"""The splits: parts of what is drawn that share no trait, arm start or seed, and the ledger of `test`."""

from __future__ import annotations

import hashlib
import re
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import hrl_comfort
from hrl_comfort import humans
from hrl_comfort.comfort.fitted import PERSONS
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import SPLITS, ConfigError, EvaluateConfig
from hrl_comfort.deploy.dataset import dataset
from hrl_comfort.envs.inputs import replayed
from hrl_comfort.evaluation import ledger, rollout
from hrl_comfort.evaluation.evaluate import evaluate
from hrl_comfort.files.provenance import ROOT, git
from hrl_comfort.files.run_config import environment
from hrl_comfort.humans.evaluation import SHARES
from hrl_comfort.scene.workcell import build_scene
from hrl_comfort.sim.episode_sampler import Draw, EpisodeSampler
from hrl_comfort.tasks import subtask

PARTS = ("train", "validation", "test")
EPISODES = 120


def draws(split: str | None, *overrides: str) -> list[Draw]:
    """Return the first draw of EPISODES episodes of a split; None is training."""
    config = environment(compose("train", ["task=place", "human=mixture", *overrides]))
    entries = None if split is None else humans.split_set(split, EPISODES)
    scene = build_scene(config.robot, config.cell, config.engine.substeps)
    sampler = EpisodeSampler(scene, config, subtask("place", "default", 1), 0, entries)
    return [next(sampler.attempts(row, 0)) for row in range(EPISODES)]


def test_people_stand_everywhere_in_every_part() -> None:
    for name in (None, *PARTS):
        places = np.concatenate([draw.spawn for draw in draws(name)])
        bearings = np.degrees(np.sort(np.arctan2(places[:, 1], places[:, 0])))
        assert np.diff(bearings, append=bearings[0] + 360).max() < 60, "no sector is left out"


def test_the_parts_share_no_trait_start_or_seed() -> None:
    seen = {name: draws(name) for name in PARTS}
    for name, found in seen.items():
        traits = np.concatenate([draw.traits for draw in found])
        low, high = SHARES[name]
        assert ((traits[:, 1:] >= low) & (traits[:, 1:] < high)).all()
        assert np.ptp(traits[:, 0]) > 0.9, "each part has every motion"
    starts = {name: {draw.start.tobytes() for draw in found} for name, found in seen.items()}
    assert len(starts["test"]) > 5
    assert not starts["train"] & starts["test"] and not starts["validation"] & (starts["train"] | starts["test"])
    seeds = [set(humans.split_set(name, most).episode_seed.tolist()) for name, (*_, most) in SPLITS.items()]
    assert len(set.union(*seeds)) == sum(map(len, seeds))


def test_the_parts_share_no_person_who_rates() -> None:
    for whole in ("true", "false"):
        seen = {name: {int(draw.person) for draw in draws(name, f"human.partitioned={whole}")} for name in PARTS}
        assert all(len(found) > 50 for found in seen.values())
        for name, (low, high) in ((name, SHARES[name]) for name in PARTS):
            assert all(low * PERSONS <= person < high * PERSONS for person in seen[name])
    assert max(int(draw.person) for draw in draws(None)) < SHARES["train"][1] * PERSONS


def test_training_draws_from_the_part_of_train() -> None:
    assert shared(draws(None)) == {"train"}


def test_without_partition_all_but_test_draw_everything() -> None:
    whole = ["human.partitioned=false"]
    for name in (None, "train", "validation", "paper"):
        assert shared(draws(name, *whole)) == set(PARTS)
    assert shared(draws("test", *whole)) == {"test"}


def shared(found: list[Draw]) -> set[str]:
    """Return the parts of which traits are among those drawn."""
    traits = np.concatenate([draw.traits[:, 1:].ravel() for draw in found])
    return {name for name in PARTS if ((SHARES[name][0] <= traits) & (traits < SHARES[name][1])).any()}


def test_recordings_are_split_whole(tmp_path: Path) -> None:
    for index in range(10):
        (tmp_path / f"{index}.csv").write_text(f"t,x,y,yaw\n0,{index},0,0\n")
    config = compose("train", ["human=recorded", f"human.file={tmp_path}", "human.partitioned=true"]).human
    seen = {}
    for name in PARTS:
        low, high = SHARES[name]
        traits = low + (high - low) * np.random.default_rng(0).random((200, humans.TRAITS))
        seen[name] = set(humans.begin(config, np.zeros((200, 2)), traits).position[:, 0].tolist())
    assert seen == {"train": {0, 1, 2, 3, 4, 5}, "validation": {6, 7}, "test": {8, 9}}
    (tmp_path / "9.csv").unlink()
    with pytest.raises(ConfigError, match="holds 9 recordings"):
        humans.begin(
            compose("train", ["human=recorded", f"human.file={tmp_path}/", "human.partitioned=true"]).human,
            np.zeros((1, 2)),
        )


REACH = ("task=reach", "policy=expert", "episodes=3", "split=test")


@pytest.fixture
def looks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], pd.DataFrame]:
    """Return what reads a ledger of the test's own."""
    monkeypatch.setattr(ledger, "FILE", tmp_path / "runs" / "ledger.csv")
    return lambda: pd.read_csv(ledger.FILE)


def asked(tmp_path: Path, *words: str) -> EvaluateConfig:
    config = compose("evaluate", [*REACH, f"output='{tmp_path / 'eval'}'", *words])
    assert isinstance(config, EvaluateConfig)
    return config


def test_each_look_at_test_is_in_the_ledger(tmp_path: Path, looks: Callable[[], pd.DataFrame]) -> None:
    evaluate(asked(tmp_path, "split=validation"))
    assert not ledger.FILE.exists()
    evaluate(asked(tmp_path))
    hrl_comfort.evaluate("random", "reach", 2, split="test")
    lines = looks()
    assert tuple(lines.columns) == ledger.HEADER
    assert lines["policy"].tolist() == ["expert", "expert", "random", "random"]
    assert lines["success"].notna().tolist() == [False, True, False, True]
    assert lines["look"].nunique() == 2 and lines["command"].str.startswith("hrl-comfort").all()


@pytest.mark.parametrize(
    ("called", "said"),
    [
        (["-m", "hrl_comfort.benchmarks.tops", "table.csv"], "python -m hrl_comfort.benchmarks.tops table.csv"),
        (["-m", "hrl_comfort", "table.csv"], "hrl-comfort table.csv"),
        ([".venv/bin/hrl-comfort", "table.csv"], "hrl-comfort table.csv"),
    ],
)
def test_a_look_names_the_command_as_the_manifest_does(
    tmp_path: Path, looks: Callable[[], pd.DataFrame], monkeypatch: pytest.MonkeyPatch, called: list[str], said: str
) -> None:
    monkeypatch.setattr(sys, "orig_argv", ["python", *called])
    monkeypatch.setattr(sys, "argv", [called[0], "table.csv"])
    ledger.open_split(asked(tmp_path))
    assert looks()["command"].tolist() == [said]


def test_a_look_names_all_that_act(tmp_path: Path, looks: Callable[[], pd.DataFrame]) -> None:
    (tmp_path / "top").mkdir()
    (tmp_path / "top" / "model.zip").write_bytes(b"1")
    ledger.open_split(asked(tmp_path), further=[str(tmp_path / "top")])
    named = looks()["policy"].iloc[0].split()[-1]
    assert named.startswith(f"{tmp_path / 'top'}@") and len(named.rpartition("@")[2]) == 16


def test_a_data_set_is_a_look(tmp_path: Path, looks: Callable[[], pd.DataFrame]) -> None:
    pytest.importorskip("minari", reason="minari is not installed: pip install -e '.[test]'")
    dataset(asked(tmp_path))
    assert looks()["look"].nunique() == 1


def test_an_interrupted_look_is_in_the_ledger(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, looks: Callable[[], pd.DataFrame]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(rollout, "execute", interrupted)
    with pytest.raises(KeyboardInterrupt):
        evaluate(asked(tmp_path))
    assert looks()[["policy", "episodes"]].values.tolist() == [["expert", 3]]


def test_a_look_leaves_the_tree_clean() -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("no git repository here")
    assert git("check-ignore", str(ledger.FILE.relative_to(ROOT))) == "runs/ledger.csv"


def test_only_the_ledger_opens_a_split() -> None:
    users = {
        str(path.relative_to(ROOT / "hrl_comfort"))
        for path in (ROOT / "hrl_comfort").rglob("*.py")
        if re.search(r"\b(split_set|drawn_set)\(", path.read_text(encoding="utf-8"))
    }
    # The reset of the environments refuses `test`; the studio records in `validation`.
    assert users == {"humans/evaluation.py", "evaluation/ledger.py", "envs/inputs.py", "studio/recorder.py"}


def test_terminal_states_are_no_look_at_test(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"terminal_states= records training data.*leave split= out"):
        asked(tmp_path, "terminal_states=states.npz")


def test_the_ledger_tells_a_policy_by_its_bytes(tmp_path: Path) -> None:
    (tmp_path / "policy.pt").write_bytes(b"weights")
    digest = hashlib.sha256(b"weights").hexdigest()[:16]
    assert ledger.hash_of(str(tmp_path)) == f"{tmp_path}@{digest}"
    assert ledger.hash_of(f"onnx:{tmp_path}/policy.pt") == f"onnx:{tmp_path}/policy.pt@{digest}"
    assert ledger.hash_of("expert") == "expert"
    (tmp_path / "policy.pt").rename(tmp_path / "meta_controller.pt")
    assert ledger.hash_of(str(tmp_path)) == f"{tmp_path}@{digest}"


def test_test_is_for_evaluate_alone() -> None:
    with pytest.raises(ConfigError, match="choose one of paper, train, validation"):
        replayed({"episode": 0, "split": "test"}, 1)
    with pytest.raises(ConfigError, match=r"checkpoints=all.*split=test"):
        compose("evaluate", ["checkpoints=all", "split=test", "policy=runs/pick"])
