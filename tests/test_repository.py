"""The repository stays light, and the results committed in it can be read."""

from __future__ import annotations

import json
import subprocess
from collections import Counter
from pathlib import Path

import pandas as pd
import pytest

from hrl_comfort.files.provenance import read_provenance
from hrl_comfort.files.run_config import load_config, trained_environment
from hrl_comfort.policies.actor import load_policy
from hrl_comfort.scene.workcell import scene_of
from hrl_comfort.sim.starts import recorded_starts
from hrl_comfort.tasks import Start

ROOT = Path(__file__).resolve().parent.parent
REFERENCE = ROOT / "runs" / "reference"
MAX_FILES, MAX_MB, MAX_POLICY_MB = 375, 27, 0.45
CONFIGS = sorted(REFERENCE.rglob("config.yaml"))
POLICIES = sorted(REFERENCE.rglob("policy.pt"))
ENTRIES = sorted(REFERENCE.rglob("benchmark.json"))


def named(path: Path) -> str:
    return str(path.parent.relative_to(REFERENCE))


def megabytes(files: list[Path]) -> float:
    return sum(path.stat().st_size for path in files) / 1e6


def test_committed_results_are_few_and_small() -> None:
    listed = subprocess.run(["git", "ls-files", "-z", "runs"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode != 0:
        pytest.skip("no git repository here")
    files = [ROOT / name for name in listed.stdout.split("\0") if name]
    assert len(files) <= MAX_FILES
    assert megabytes(files) <= MAX_MB


@pytest.mark.parametrize("path", CONFIGS, ids=named)
def test_every_committed_configuration_loads(path: Path) -> None:
    assert load_config(path).output == str(path.parent)


@pytest.mark.parametrize("path", POLICIES, ids=named)
def test_a_committed_skill_can_be_evaluated_alone(path: Path) -> None:
    env = trained_environment(str(path.parent))
    assert env is not None
    kinds = len(env.cell.kinds)
    hand = 0
    if env.robot.gripper.holds:
        model = scene_of(env).model
        hand = model.nq + model.nv + 1 + kinds * env.randomise.resized
    assert env.task.start == "ik" or len(recorded_starts(env, Start.AT_OBJECT, 6, hand) or []) == kinds


@pytest.mark.parametrize("path", POLICIES, ids=named)
def test_a_committed_policy_is_small_finished_and_acts(path: Path) -> None:
    assert megabytes([path]) <= MAX_POLICY_MB
    assert read_provenance(path.parent).finished
    assert load_policy(path).spec["task"] == load_config(path.parent).task.name


@pytest.mark.parametrize("path", sorted(REFERENCE.rglob("episodes.parquet")), ids=named)
def test_committed_episodes_can_be_read(path: Path) -> None:
    episodes = pd.read_parquet(path)
    assert len(episodes) >= 16 and episodes["success"].dtype == bool
    assert {"policy_steps", "spawn_id", "train_seed"} <= set(episodes.columns)


@pytest.mark.parametrize("path", ENTRIES, ids=named)
def test_an_entry_of_the_benchmark_has_its_line_in_the_ledger(path: Path) -> None:
    entry = json.loads(path.read_text(encoding="utf-8"))
    ledger = pd.read_csv(REFERENCE / "ledger.csv")
    written = ledger["command"].str.extract(r" output=(\S+)", expand=False)
    for task, levels in entry["parts"].items():
        its = ledger[
            (ledger["commit"].str.rstrip("+") == entry["commit"].rstrip("+"))
            & (ledger["policy"] == " ".join(entry["policies"].values()))
            & (ledger["episodes"] == sum(level["shifts"] for level in levels))
            & (ledger["task"] == task)
            & (written == str(path.parent.relative_to(ROOT)))
        ]
        assert len(its) == 1 and its["command"].str.startswith("hrl-comfort benchmark ").all()


def test_no_folder_of_the_package_is_crowded_and_no_module_long() -> None:
    modules = [*(ROOT / "hrl_comfort").rglob("*.py")]
    assert {each.name for each in modules if len(each.read_text(encoding="utf-8").splitlines()) > 350} == set()
    assert {folder for folder, count in Counter(each.parent for each in modules).items() if count > 15} == set()
