"""Fixtures of a small repository with a result."""

from __future__ import annotations

from pathlib import Path

import pytest

from hrl_comfort.files import provenance
from hrl_comfort.results import looks, manifest, record, remake, verify
from tests.results.checkout import Ran, commit


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


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> Ran:
    stands_in = Ran()
    monkeypatch.setattr(verify, "run", stands_in)
    return stands_in
