"""The lines of docs/environments.md and the Python of the README run as they are shown, with small budgets."""

from __future__ import annotations

import multiprocessing
import re
from collections.abc import Iterator
from pathlib import Path

import gymnasium
import pytest

import hrl_comfort
from tests.envs.pictures import drawn

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "environments.md").read_text(encoding="utf-8")
README = (ROOT / "README.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| ([^|]+) \|[^|]*\| `(.+)`<br>`(.+)` \|$", PAGE, re.MULTILINE)
BLOCKS = [
    block for page in (README, PAGE) for block in re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
]
IMPORTS = "from stable_baselines3 import SAC\n"
"""Of the rows above a row."""


def run(code: str) -> None:
    """Run code with a thousandth of its training and four cells."""
    small = re.sub(r"learn\((\d+)_000\)", r"learn(\1)", code).replace("64", "4")
    exec(small, {"gymnasium": gymnasium, "hrl_comfort": hrl_comfort, "ID": "hrl_comfort.gym:hrl_comfort/Pick-v0"})


@pytest.fixture(autouse=True)
def forked() -> Iterator[None]:
    """Fork processes, as Gymnasium does on Linux: TorchRL's default, spawn, imports torch in every one."""
    before = multiprocessing.get_start_method()
    multiprocessing.set_start_method("fork", force=True)
    yield
    multiprocessing.set_start_method(before, force=True)


def test_every_row_of_the_table_is_found() -> None:
    assert len(ROWS) == PAGE.count("<br>") >= 12


@pytest.mark.parametrize(("client", "first", "second"), ROWS, ids=[row[0] for row in ROWS])
def test_the_lines_of_a_client_run(
    client: str, first: str, second: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    drawn(lambda: run(f"{IMPORTS}{first}\n{second}"))


@pytest.mark.parametrize("block", BLOCKS)
def test_the_python_of_the_pages_runs(block: str) -> None:
    run(block)
