"""Every command of README.md and of the other pages runs as written, in one folder a page; so does every example."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.commands import ROOT, commands, run, write_files

PAGES = [ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
EXAMPLES = {
    "act.py": "", "evaluate_and_plot.py": "2", "own_task.py": "", "train_options.py": "16 2",
    "train_sb3.py": "200 pick.zip",
}  # fmt: skip
"""Arguments that make an example short."""
FEW = {
    "measure.ROUNDS": 1, "measure.SECONDS": 0.01, "env.NUM_ENVS": (1, 4), "env.SIZES": {}, "update.BATCHES": (32,),
    "train.SEEDS": range(1), "train.CHECK_EPISODES": 4, "train.CHECK_GROWTH": 4,
}  # fmt: skip
"""Rounds and seeds of the benchmarks."""


def check(page: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    for name, few in FEW.items():
        monkeypatch.setattr(f"hrl_comfort.benchmarks.{name}", few)
    (folder / "runs").mkdir()
    for committed in ("runs/reference", "tests"):  # there in every clone
        (folder / committed).symlink_to(ROOT / committed)
    write_files(page, folder)
    for line in commands(page):
        run(line)


def test_every_command_of_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check(ROOT / "README.md", tmp_path, monkeypatch)


@pytest.mark.docs
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_of_a_page_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check(page, tmp_path, monkeypatch)


@pytest.mark.docs
@pytest.mark.parametrize("file", sorted((ROOT / "examples").glob("*.py")), ids=lambda file: file.stem)
def test_every_example_runs(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run(f"python {file} {EXAMPLES[file.name]}")
