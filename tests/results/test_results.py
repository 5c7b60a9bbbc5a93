"""Every published number, picture and file comes from the manifest, and says of which commit it is."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from hrl_comfort.benchmarks import returns
from hrl_comfort.cli.main import command_of
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import (
    CONTROL_STEP_S,
    ConfigError,
    EvaluateConfig,
    HierarchyTrainConfig,
    MetaControllerTrainConfig,
    ResultsConfig,
    TrainConfig,
)
from hrl_comfort.config.overrides import check_overrides, root_of
from hrl_comfort.evaluation import ledger
from hrl_comfort.files import provenance
from hrl_comfort.files.run_config import environment
from hrl_comfort.results import looks, manifest, pages, record, remake, tables
from hrl_comfort.results.command import results
from hrl_comfort.results.manifest import PHASES, Entry
from hrl_comfort.training.hierarchy_trainer import controller_config

ROOT = provenance.ROOT

ENTRIES = manifest.manifest()

HELD = ("README.md", "docs/results.md")
"""Pages of which every number is a result or marked as given."""

VERSION = re.compile(r"(?:Python|version|or) \d+\.\d+")

GIVEN = re.compile(r"<!-- given -->.*?<!-- end -->", re.DOTALL)

NUMBER = re.compile(r"[−-]?\d+\.\d+|[−-]?\d+(?: | )?%")


def in_git() -> bool:
    return (ROOT / ".git").exists()


def test_every_tracked_artefact_belongs_to_one_result() -> None:
    if not in_git():
        pytest.skip("no git repository here")
    owners = {path: [name for name, each in ENTRIES.items() if each.owns(path)] for path in manifest.tracked()}
    assert {path: names for path, names in owners.items() if len(names) != 1} == {}


@pytest.mark.parametrize("name", ENTRIES)
def test_the_commands_of_a_result_are_accepted_and_its_pages_are_there(name: str) -> None:
    each = ENTRIES[name]
    assert all((ROOT / page).is_file() for page in each.pages)
    commands = [words for phase in PHASES for words in each.commands(phase)]
    assert bool(commands) != bool(each.by_hand)
    for program, *words in commands:
        if program == "hrl-comfort":
            command, overrides = command_of(words)
            assert check_overrides(root_of(command), overrides)
        else:
            assert (ROOT / f"{words[1].replace('.', '/')}.py").is_file()


def test_the_published_controllers_are_those_that_the_experiment_trains_above_its_skills(tmp_path: Path) -> None:
    commands = ENTRIES["comfort_shift_learned"].commands("train")
    assert len(commands) == len(ENTRIES["comfort_shift"].seeds)
    for seed, words in zip(ENTRIES["comfort_shift"].seeds, commands, strict=True):
        whole = compose("train_hierarchy", ["experiment=comfort_shift", f"train_seed={seed}"])
        published = compose("train_meta_controller", words[3:])
        assert isinstance(whole, HierarchyTrainConfig) and isinstance(published, MetaControllerTrainConfig)
        trained = controller_config(whole, tmp_path)
        assert trained is not None and trained.human.partitioned
        assert replace(published, policies=trained.policies, output=trained.output) == trained


def test_the_chain_of_the_grasp_is_measured_in_the_world_that_trains_it() -> None:
    trained = compose("train_hierarchy", ["experiment=grasp"])
    commands = [words[2:] for words in ENTRIES["grasp"].commands("evaluate") if "task=cycle" in words]
    for words in commands:
        own = [word for word in words if not word.startswith(("gripper=", "cell.objects."))]
        elsewhere = [word for word in own if word == "cell=grasp"]  # the row `table`
        measured = compose("evaluate", [*own, *(["cell=grasp_varied"] if elsewhere else [])])
        assert isinstance(trained, HierarchyTrainConfig) and isinstance(measured, EvaluateConfig)
        task = replace(
            measured.task, name=trained.task.name, max_episode_steps=trained.task.max_episode_steps,
            max_option_steps=trained.task.max_option_steps,
            resample_start_probability=trained.task.resample_start_probability,  # of trainings alone
        )  # fmt: skip
        world = replace(environment(measured), task=task)
        assert world == replace(environment(trained), reward=world.reward, engine=world.engine)


def test_the_schedule_is_measured_on_the_pick_of_the_grasp() -> None:
    grasp = compose("train_hierarchy", ["experiment=grasp"])
    for words in ENTRIES["schedule"].commands("train"):
        own = compose("train", words[2:])
        assert isinstance(grasp, HierarchyTrainConfig) and isinstance(own, TrainConfig)
        task = replace(
            own.task, resample_start_probability=grasp.task.resample_start_probability,
            max_option_steps=grasp.task.max_option_steps,
        )  # fmt: skip
        assert replace(environment(own), task=task) == environment(grasp)
        assert replace(own.agent, policy_steps=grasp.agent.policy_steps) == grasp.agent


def test_packed_episodes_keep_every_bit(tmp_path: Path) -> None:
    rows = pd.DataFrame({
        "a": [0.1, -0.0, np.nan, np.inf], "n": [1, 2, 3, -4], "on": [True, False, True, True],
        "word": ["x", "", "y", "z"],
    })  # fmt: skip
    for columns in list(rows), ["n", "word"]:
        with (file := tmp_path / "episodes.parquet").open("wb") as target:
            remake.pack(rows[columns], target)
        again = pd.read_parquet(file)
        pd.testing.assert_frame_equal(again, rows[columns], check_exact=True)
        assert "a" not in columns or again["a"].to_numpy().tobytes() == rows["a"].to_numpy().tobytes()


def test_what_an_order_missed_and_a_second_of_discomfort_cost_is_what_it_cost_in_training() -> None:
    trained = compose("train_meta_controller", ENTRIES["comfort_shift_learned"].commands("train")[0][3:])
    assert isinstance(trained, MetaControllerTrainConfig)
    reward, comfort = trained.reward, trained.comfort
    assert (reward.place, reward.missed) == (1.0, -returns.MISSED)
    marked = re.search(r"<!-- returns: (\S+) ", (ROOT / "docs/results.md").read_text(encoding="utf-8"))
    assert marked and float(marked[1]) == pytest.approx(comfort.scale * comfort.alpha / CONTROL_STEP_S)
    assert comfort.alpha == comfort.beta


def test_the_pages_are_filled_from_the_committed_results() -> None:
    for page in pages.pages():
        text = page.read_text(encoding="utf-8")
        assert pages.filled(text) == text, "run hrl-comfort results fill=true"


@pytest.mark.parametrize("name", HELD)
def test_every_number_of_a_page_is_a_result_or_given(name: str) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    for marked in (pages.TABLE, pages.CELL, GIVEN):
        text = marked.sub("", text)
    prose = re.sub(r"```.*?```|`[^`]*`|\]\([^)]*\)", "", text, flags=re.DOTALL)
    assert NUMBER.findall(VERSION.sub("", prose)) == []


@pytest.mark.parametrize("name", HELD)
def test_every_picture_of_a_page_belongs_to_a_result(name: str) -> None:
    page = ROOT / name
    for target in re.findall(r"!\[[^]]*\]\(([^)]*)\)", page.read_text(encoding="utf-8")):
        path = str((page.parent / target).resolve().relative_to(ROOT))
        assert any(each.owns(path) and name in each.pages for each in ENTRIES.values()), target


def test_a_number_in_prose_is_a_cell_of_a_table(monkeypatch: pytest.MonkeyPatch) -> None:
    table = "| policy | level | balls |\n| --- | --- | --- |\n| a | 1 | 2.0 |\n| a | 10 | 5.0 |\n"
    monkeypatch.setitem(pages.KINDS, "entries", lambda names: table)
    pages.table.cache_clear()
    page = "It places <!-- cell: entries: tried :: a :: 10 :: balls -->?<!-- end --> balls."
    assert pages.filled(page) == page.replace("?", "5.0")
    with pytest.raises(ConfigError, match=r"2 rows begin so; columns are policy, level, balls"):
        pages.filled(page.replace(" :: 10", ""))
    pages.table.cache_clear()


def test_what_is_not_measured_says_so() -> None:
    page = "<!-- evaluations: no/such -->\nold\n<!-- end -->"
    assert pages.ABSENT in pages.filled(page) and "old" not in pages.filled(page)


def test_campaigns_of_the_hand_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "REFERENCE", tmp_path)
    places = "robot,gripper,cell,object,place,lifted,held,placed,fastest_m_s"
    rows = [f"ur3e,two_finger,grasp,{kind},{place},True,True,{not place},0.7" for kind in "ab" for place in (0, 1)]
    (tmp_path / "grasps.csv").write_text("\n".join([places, *rows, ""]), encoding="utf-8")
    cycles = "cycle,pulled,stopped,success,noticed,noticed_s\n0,False,,True,,\n0,True,grip lost,False,True,0.288\n"
    (tmp_path / "cycles.csv").write_text(cycles, encoding="utf-8")
    told = tables.KINDS["grasps"]("grasps.csv").splitlines()
    assert told[2] == "| `a` of `cell=grasp` | 2 / 2 / 1 |" and told[-1] == "| fastest, m/s | 0.70 |"
    assert tables.KINDS["hand cycles"]("cycles.csv").splitlines()[-1] == "| 1 | 1 | 1 | 1 | 0.29 |"


def test_the_benchmark_writes_an_evaluation_for_each_task_of_its_suite() -> None:
    words = ["hrl-comfort", "benchmark", "policy=expert", "output=x"]
    assert remake.evaluations_of(words) == [Path("x/kitting"), Path("x/shift")]
    assert remake.evaluations_of([*words, "suite=[shift]"]) == [Path("x/shift")]
    assert remake.evaluations_of(["hrl-comfort", "evaluate", "output=x"]) == [Path("x")]


def test_looks_are_published_with_their_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    entry = Entry(about="x", evaluate=["hrl-comfort evaluate policy=expert split=test output=a"], artefacts=["runs/a"])
    monkeypatch.setattr(looks, "manifest", lambda: {"entry": entry})
    monkeypatch.setattr(looks, "LEDGER", tmp_path / "committed.csv")
    monkeypatch.setattr(ledger, "FILE", tmp_path / "ledger.csv")

    def line(look: str, commit: str, words: str, success: str = "") -> str:
        return f"{look},now,{commit},hrl-comfort evaluate {words},expert,reach,arc,3,{success},,\n"

    head = ",".join(ledger.HEADER) + "\n"
    mine = "policy=expert split=test"
    looks.LEDGER.write_text(
        head + line("a", "1+", mine) + line("b", "2", f"{mine} output=b") + line("c", "2", "policy=random split=test"),
        encoding="utf-8",
    )
    ledger.FILE.write_text(
        head + line("d", "3", f"{mine} output=a --overwrite") + line("d", "3", f"{mine} output=a --overwrite", "0.5")
        + line("e", "3+", mine) + line("f", "3", "policy=expert split=test human=arc"),
        encoding="utf-8",
    )  # fmt: skip
    assert looks.merge() == [f"not published, its tree had uncommitted changes: hrl-comfort evaluate {mine}"]
    found = pd.read_csv(looks.LEDGER)
    assert found["look"].tolist() == ["b", "d"] and found["success"].tolist()[1] == 0.5


def test_a_look_is_kept_until_another_policy_lies_in_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(looks, "ROOT", tmp_path)
    line = {"command": "hrl-comfort evaluate policy=p", "policy": "p@0123456789abcdef"}
    commands = {looks.words_of(line["command"])}
    assert looks.is_kept(line, commands)
    (tmp_path / "p" / "test").mkdir(parents=True)
    assert looks.is_kept(line, commands), "the folder holds an evaluation alone"
    (tmp_path / "p" / "policy.pt").write_bytes(b"another")
    assert not looks.is_kept(line, commands)


def test_every_published_look_is_of_a_command_of_the_manifest() -> None:
    lines = pd.read_csv(record.LEDGER, dtype=str, keep_default_na=False)
    assert list(lines.columns) == list(ledger.HEADER)
    commands = looks.published()
    assert all(looks.is_kept(line, commands) for line in lines.to_dict("records"))


def test_no_such_result_is_refused_in_one_line() -> None:
    if not in_git():
        pytest.skip("no git repository here")
    for key in ("name", "remake", "verify"):
        asked = {"name": None, "remake": None, "train": False, "verify": None, "fill": False, key: "comfrt"}
        with pytest.raises(ConfigError, match=rf"{key}='?comfrt"):
            results(ResultsConfig(**asked))
