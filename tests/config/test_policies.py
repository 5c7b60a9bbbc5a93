"""Words of the command line that stand for policies."""

from __future__ import annotations

from pathlib import Path

import pytest

from hrl_comfort.config.policies import options_in, with_defaults


def test_without_arguments_the_demo_is_played_if_there_is_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert with_defaults(["human=arc"]) == ["human=arc", "policy=expert"]
    for name in ("pick", "place", "return"):
        folder = tmp_path / "runs" / "demo" / name
        folder.mkdir(parents=True)
        (folder / "policy.pt").touch()
    assert options_in(Path("runs/demo")) == ("pick", "place", "return")
    assert with_defaults([]) == [
        "policies.pick=runs/demo/pick", "policies.place=runs/demo/place", "policies.return=runs/demo/return",
        "meta_controller.options=['pick','place','return']", "meta_controller=scripted", "task=cycle",
    ]  # fmt: skip
    assert with_defaults(["policy=random"]) == ["policy=random"]
