"""A result is stale once its code has changed, and is made anew from a clean tree alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from hrl_comfort.config import (
    ConfigError,
)
from hrl_comfort.files import provenance
from hrl_comfort.results import record, remake, verify
from tests.results.checkout import EVALUATED, MADE, commit


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


def test_a_result_stays_current_when_comments_docstrings_and_layout_change(checkout: Path) -> None:
    source = '"""A module."""\nx = 1\n"""A number."""\n\n\ndef f():\n    """Return it."""\n    return x\n'
    (checkout / "code.py").write_text(source, encoding="utf-8")
    record.write_record("made", record.Record(commit=commit(checkout), commands=[]))
    reworded = source.replace("A module", "The module").replace("A number", "One").replace("Return it", "Return x")
    (checkout / "code.py").write_text(f"# First.\n{reworded}".replace("x = 1", "x = (1)"), encoding="utf-8")
    assert record.state("made", MADE) == "current"
    (checkout / "code.py").write_text(reworded.replace("x = 1", "x = 2"), encoding="utf-8")
    assert record.state("made", MADE).startswith("stale: 1 files changed")


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


def test_a_command_that_fails_publishes_nothing(checkout: Path) -> None:
    with pytest.raises(ConfigError, match="python -m nothing failed"):
        remake.remake("made", MADE, train=False, jobs=1)
    assert record.read_record("made") is None
