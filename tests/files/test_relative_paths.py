"""Paths in a run folder lead to the same file from wherever it is read."""

from __future__ import annotations

from pathlib import Path

import pytest

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import EvaluateConfig
from hrl_comfort.files.run_config import is_same, load_config, save_config


@pytest.mark.parametrize("given", ["walk.csv", "../walk.csv", ".."])
def test_a_path_into_the_working_directory_is_found_by_a_run_beside_it(
    given: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, run = tmp_path / "here", tmp_path / "run"
    here.mkdir()
    run.mkdir()
    monkeypatch.chdir(here)
    config = compose("evaluate", ["human=random_walk", f"human.file={given}"])
    save_config(config, run / "config.yaml")
    loaded = load_config(run / "config.yaml")
    assert isinstance(loaded, EvaluateConfig) and loaded.human.file is not None
    assert Path(loaded.human.file).resolve() == (here / given).resolve()
    assert is_same(loaded, config)
