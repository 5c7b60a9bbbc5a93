"""Every published number, picture and file comes from the manifest, and says of which commit it is."""

from __future__ import annotations

import re
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

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
from hrl_comfort.results import looks, manifest, pages, record, remake, tables, verify
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


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a repository with code, a result in runs/ and its record."""
    for module in (provenance, manifest, record, remake, verify, looks):
        monkeypatch.setattr(module, "ROOT", tmp_path)
    monkeypatch.setattr(record, "RECORDS", tmp_path / "runs" / "records")
    for name in ("code.py", "runs/made.csv", "other.py", "README.md"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("1\n", encoding="utf-8")
    commit(tmp_path, "init", "-q")
    commit(tmp_path)
    return tmp_path


def commit(folder: Path, *first: str) -> str:
    """Commit everything in a repository, or run `git FIRST`; return the commit."""
    me = ("-c", "user.name=test", "-c", "user.email=test@test")
    for words in [first] if first else [("add", "-A"), ("commit", "-qm", "x")]:
        subprocess.run(["git", "-C", str(folder), *me, *words], check=True)
    done = subprocess.run(["git", "-C", str(folder), "rev-parse", "HEAD"], capture_output=True, text=True, check=False)
    return done.stdout.strip()


MADE = Entry(
    about="x", pages=["README.md"], draw=["python -m nothing"], artefacts=["runs/made.csv"], decided_by=["code.py"]
)


def test_a_result_is_stale_once_what_decides_it_has_changed(checkout: Path) -> None:
    assert record.state("made", MADE) == "no record"
    first = provenance.commit()
    assert first is not None
    record.write_record("made", record.Record(commit=first, commands=[]))
    (checkout / "other.py").write_text("2\n", encoding="utf-8")
    commit(checkout)
    assert record.state("made", MADE) == "current"
    (checkout / "code.py").write_text("2\n", encoding="utf-8")
    second = commit(checkout)
    assert record.state("made", MADE) == f"stale: 1 files changed since {first[:7]}, code.py first"
    record.write_record("made", record.Record(commit=first, verified=second, commands=[]))
    assert record.state("made", MADE) == "current"
    record.write_record("made", record.Record(commit=f"{first}+", commands=[]))
    assert record.state("made", MADE) == "made with uncommitted changes"
    (checkout / "runs" / "made.csv").unlink()
    assert record.state("made", MADE) == "missing: runs/made.csv"


def test_nothing_is_published_from_a_tree_with_uncommitted_changes(
    checkout: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(record, "manifest", lambda: {"made": MADE})
    (checkout / "runs" / "made.csv").write_text("2\n", encoding="utf-8")
    (checkout / "README.md").write_text("filled\n", encoding="utf-8")
    made = record.need_clean_tree()  # neither a result nor a filled page is a change of the code
    assert made == provenance.commit() == commit(checkout, "status", "--short")
    (checkout / "code.py").write_text("2\n", encoding="utf-8")
    for publish in (lambda: remake.remake("made", MADE, train=False, jobs=1), lambda: verify.verify("made", MADE)):
        with pytest.raises(ConfigError, match=r"code\.py has uncommitted changes \(1 files\); commit them"):
            publish()


def test_a_result_whose_policies_are_not_kept_is_refused_before_anything_runs(
    checkout: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(remake, "run", lambda words: pytest.fail(f"{words} ran"))
    (checkout / "runs" / "p0").mkdir()
    with pytest.raises(ConfigError, match=r"^remake=made: runs/p1 is not kept; say train=true, which trains it again$"):
        remake.remake("made", EVALUATED, train=False, jobs=1)


def test_a_result_is_made_anew_by_a_module_that_would_go_on_with_what_is_there(checkout: Path) -> None:
    code = "import sys\nopen(sys.argv[1], 'a').write('2\\n')\n"
    (checkout / "goes_on.py").write_text(code, encoding="utf-8")
    commit(checkout)
    entry = MADE.model_copy(update={"draw": ["python -m goes_on runs/made.csv"]})
    remake.remake("made", entry, train=False, jobs=1)
    assert (checkout / "runs" / "made.csv").read_text(encoding="utf-8") == "2\n"
    assert record.read_record("made") is not None


EVALUATED = MADE.model_copy(
    update={
        "draw": [],
        "seeds": [0, 1],
        "train": ["hrl-comfort train hierarchy agent.policy_steps=9000 train_seed={seed} output=runs/p{seed}"],
        "evaluate": ["hrl-comfort evaluate policy=runs/p{seed} episodes=1 output=runs/e{seed}"],
    }
)
"""A result of a training."""
COMMANDS = [" ".join(words) for phase in PHASES for words in EVALUATED.commands(phase)]


class Ran:
    """Stands in for commands: notes them with the code in code.py, which an evaluation gives as the success."""

    def __init__(self) -> None:
        self.words: list[list[str]] = []
        self.code: list[str] = []

    def __call__(self, words: list[str], code: Path) -> None:
        self.words.append(words)
        self.code.append((code / "code.py").read_text(encoding="utf-8").strip())
        if words[1] == "evaluate":
            output = Path(remake.output_of(words))
            output.mkdir(parents=True)
            (output / "episodes.csv").write_text(
                f"episode,comfort_level,success\n0,,{self.code[-1]}\n", encoding="utf-8"
            )


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> Ran:
    stands_in = Ran()
    monkeypatch.setattr(verify, "run", stands_in)
    return stands_in


def test_a_result_is_verified_by_the_code_of_its_record_and_that_of_now(checkout: Path, ran: Ran) -> None:
    with pytest.raises(ConfigError, match=r"^verify=made: it has no record of a commit, or no command that writes"):
        verify.verify("made", EVALUATED)
    (checkout / "runs" / "p1").mkdir()
    (checkout / "runs" / "p1" / "policy.pt").touch()
    (checkout / "runs" / "p0").mkdir()  # as with committed episodes of policies that are not
    first = commit(checkout)
    record.write_record("made", record.Record(commit=first, commands=COMMANDS))
    (checkout / "other.py").write_text("", encoding="utf-8")
    second = commit(checkout)
    assert verify.verify("made", EVALUATED) == "", "the code that decides is the same"
    kept = record.read_record("made")
    assert kept is not None and (kept.commit, kept.verified) == (first, second)
    assert ran.code == ["1", "1"] and [words[2] for words in ran.words] == ["policy=runs/p1"] * 2, "of the seed kept"
    (checkout / "code.py").write_text("0\n", encoding="utf-8")
    commit(checkout)
    assert "success False, before True" in verify.verify("made", EVALUATED)
    assert record.read_record("made") == kept and not provenance.git("worktree", "list", "--porcelain").count("code")


def test_where_no_policies_are_kept_the_first_seed_is_trained_for_a_few_steps_by_both(checkout: Path, ran: Ran) -> None:
    record.write_record("made", record.Record(commit=str(provenance.commit()), commands=COMMANDS))
    assert verify.verify("made", EVALUATED) == ""
    trained, evaluated, *now = ran.words
    assert [words[1] for words in now] == ["train", "evaluate"] and trained[:3] == ["hrl-comfort", "train", "hierarchy"]
    assert [word for word in trained if word.startswith("agent.policy_steps=")] == ["agent.policy_steps=2500"]
    folder = next(word.partition("=")[2] for word in trained if word.startswith("output="))
    assert f"policy={folder}" in evaluated and not Path(folder).exists() and not (checkout / "runs" / "p0").exists()


def test_what_cannot_be_compared_is_not_verified(checkout: Path, ran: Ran) -> None:
    here = str(provenance.commit())
    record.write_record("made", record.Record(commit=here, commands=[]))
    with pytest.raises(
        ConfigError, match=r"^verify=made: its record has no command hrl-comfort evaluate policy=runs/p0"
    ):
        verify.verify("made", EVALUATED)
    record.write_record("made", record.Record(commit=here, commands=COMMANDS))
    with pytest.raises(ConfigError, match=r"^verify=made: its policies are not kept, and it trains none$"):
        verify.verify("made", EVALUATED.model_copy(update={"train": []}))
    record.write_record("made", record.Record(commit="0" * 40, commands=COMMANDS))
    with pytest.raises(
        ConfigError, match=r"^commit 0000000 cannot be checked out; if it is not in this clone, fetch it"
    ):
        verify.verify("made", EVALUATED)
    assert ran.words == []


def test_another_checkout_of_the_package_runs_a_command(checkout: Path, tmp_path: Path) -> None:
    here = checkout / "hrl_comfort" / "__main__.py"
    here.parent.mkdir()
    here.write_text("raise SystemExit(1)\n", encoding="utf-8")
    package = tmp_path / "code" / "hrl_comfort"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "__main__.py").write_text("import sys\nopen(sys.argv[-2], 'w').close()\n", encoding="utf-8")
    remake.run(["hrl-comfort", "ran_by_it"], package.parent)
    assert (checkout / "ran_by_it").exists()


def test_a_command_that_fails_publishes_nothing(checkout: Path) -> None:
    with pytest.raises(ConfigError, match="python -m nothing failed"):
        remake.remake("made", MADE, train=False, jobs=1)
    assert record.read_record("made") is None


def episodes(**columns: Any) -> pd.DataFrame:
    return pd.DataFrame({"episode": [0, 1], "comfort_level": [1, 1], "return": [0.5, None], **columns})


def test_a_result_is_verified_digit_by_digit() -> None:
    known = episodes()
    assert verify.difference(known, episodes(later=[1, 2])) == ""
    other = episodes(**{"return": [0.500001, None]})
    assert verify.difference(known, other) == "episode 0: return 0.500001, before 0.5"
    assert verify.difference(known, episodes().drop(columns="return")) == "no column return any more"
    assert verify.difference(known[:1], episodes()) == "other episodes"
    assert verify.difference(known, episodes()[:1]) == "other episodes"


@pytest.mark.parametrize(
    ("words", "first"),
    [
        (["evaluate", "episodes=1000", "levels=[1,4]", "output=x"], ["evaluate", "episodes=40", "levels=[1]"]),
        (["evaluate", "split=test", "output=x"], ["evaluate", "split=validation", "episodes=40"]),
        (["evaluate", "episodes=30", "output=x"], ["evaluate", "episodes=30"]),
        (
            ["benchmark", "policy=expert", "output=x"],
            ["benchmark", "policy=expert", "episodes=8", "split=validation", "levels=[1]"],
        ),
        (["benchmark", "levels=[]", "output=x"], ["benchmark", "episodes=8", "split=validation", "levels=[]"]),
    ],
)
def test_a_verification_runs_the_first_episodes_at_the_first_level(words: list[str], first: list[str]) -> None:
    assert verify.shortened(["hrl-comfort", *words], "here") == ["hrl-comfort", *first, "output=here"]


def test_tops_are_verified_in_their_first_shifts_after_short_trainings(tmp_path: Path) -> None:
    entry = manifest.manifest()["kitting"]
    train, tops = entry.commands("train"), entry.commands("evaluate")[0]
    assert verify.can_be_verified(entry) and not verify.has_policies(tops)
    again = verify.shortened(tops, "runs/0")
    assert again[:5] == ["python", "-m", verify.TOPS, "runs/0/tops.csv", "2"]
    assert again[5:] == [word.replace("split=test", "split=validation") for word in tops[5:]]
    short = verify.shortly(next(words for words in train if words[1] == "-m"))
    assert short[3:6] == ["PPO", "2048", "0"]
    assert verify.placed(short[6], tmp_path, True) == str(tmp_path / short[6])
    assert verify.placed(again[5], tmp_path, True) == f"learned={tmp_path}/runs/reference/kitting/bench/*/seed*"
    known = pd.DataFrame({"top": ["due", "dqn"], "seed": [None, 0], "shift": [0, 0], "return": [1.0, 2.0]})
    assert verify.difference(known, known) == ""
    assert verify.difference(known, known.assign(**{"return": [1.0, 2.5]})) == "dqn, shift 0: return 2.5, before 2.0"


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
