"""A result is verified by its first episodes, by the code of its record and that of now."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from hrl_comfort.config import (
    ConfigError,
)
from hrl_comfort.files import provenance
from hrl_comfort.results import manifest, record, remake, verify
from tests.results.checkout import COMMANDS, EVALUATED, Ran, commit


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
