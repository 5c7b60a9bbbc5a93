"""Checkpoints by their name, and the grid of every combination of the checkpoints of a chain's parts."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from hrl_comfort.composition.compose import compose
from hrl_comfort.composition.own_files import with_own_files
from hrl_comfort.config import ConfigError, EvaluateConfig
from hrl_comfort.evaluation import checkpoints
from hrl_comfort.evaluation.evaluate import evaluate
from hrl_comfort.files.atomic import OVERWRITE
from hrl_comfort.files.provenance import step_path
from hrl_comfort.files.tables import read_table

REFERENCE = Path(__file__).resolve().parents[2] / "runs" / "reference"
STEPS = {"pick": (1000, 2000), "place": (500, 1500), "return": ()}


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """Return a folder of three runs, of which two have several checkpoints."""
    for part, steps in STEPS.items():
        folder = tmp_path / part / "checkpoints"
        folder.mkdir(parents=True)
        for name in ("config.yaml", "policy.pt"):
            shutil.copy(REFERENCE / part / name, folder.parent)
        for at in steps:
            shutil.copy(REFERENCE / part / "policy.pt", step_path(folder, at))
    return tmp_path


def grid(runs: Path, *more: str) -> EvaluateConfig:
    words = [f"policies.{part}='{runs / part}'" for part in STEPS]
    short = ["split=validation", "episodes=2", "task.start=ik"]
    chain = ["task=cycle", "meta_controller=nearest", "checkpoints=grid", f"output='{runs / 'grid'}'"]
    found = compose("evaluate", [*words, *short, *chain, *more])
    assert isinstance(found, EvaluateConfig)
    return found


def test_a_grid_has_every_combination_and_goes_on_where_it_was_stopped(
    runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[dict[str, str]] = []
    rollout = checkpoints.rollout

    def counted(config: EvaluateConfig) -> Any:
        if len(ran) == 3:
            raise KeyboardInterrupt
        ran.append(config.policies)
        return rollout(config)

    monkeypatch.setattr(checkpoints, "rollout", counted)
    with pytest.raises(KeyboardInterrupt):
        evaluate(grid(runs))
    half = read_table(runs / "grid" / "grid.csv")
    assert half is not None and len(half) == 3 and not (runs / "grid" / "grid.png").exists()
    ran.clear()
    text = (runs / "grid" / "grid.csv").read_text(encoding="utf-8")
    for whole, broken in (",place\n", ",plaice\n"), (",1000,", ",many,"):
        (runs / "grid" / "grid.csv").write_text(text.replace(whole, broken), encoding="utf-8")
        with pytest.raises(ConfigError, match=r"grid\.csv"):
            evaluate(grid(runs))
    (runs / "grid" / "grid.csv").write_text(text, encoding="utf-8")
    evaluate(grid(runs))
    assert len(ran) == 1 and (runs / "grid" / "grid.png").is_file()
    table = read_table(runs / "grid" / "grid.csv")
    assert table is not None
    assert table[["pick", "place"]].to_numpy().tolist() == [[1000, 500], [1000, 1500], [2000, 500], [2000, 1500]]
    assert table["policy_steps"].tolist() == [1500, 2500, 2500, 3500] and (table["success"] == 1).all()
    ran.clear()
    evaluate(grid(runs))
    assert ran == [], "it is whole"
    monkeypatch.setattr(checkpoints, "rollout", rollout)
    files = {name: (runs / "grid" / name).read_bytes() for name in ("grid.csv", "grid.png", "config.yaml")}
    with pytest.raises(ConfigError, match="gone"):
        evaluate(grid(runs, "policies.return=gone:act"))
    assert all((runs / "grid" / name).read_bytes() == content for name, content in files.items())
    ran.clear()
    monkeypatch.setattr(checkpoints, "rollout", lambda config: ran.append(config.policies) or rollout(config))
    evaluate(grid(runs, "episodes=1"))
    assert len(ran) == 4, "another command begins anew"
    monkeypatch.setenv(OVERWRITE, "1")
    evaluate(grid(runs, "episodes=1"))
    assert len(ran) == 8


def test_a_grid_needs_two_parts_that_differ(runs: Path) -> None:
    alone = f"policies.place='{runs / 'place'}@step=500'"
    with pytest.raises(ConfigError, match="checkpoints=grid: pick has several checkpoints in checkpoints/; give two "):
        evaluate(grid(runs, alone))
    with pytest.raises(ConfigError, match="checkpoints=grid chooses among checkpoints, which split=test is not for"):
        grid(runs, "split=test")
    with pytest.raises(ConfigError, match="checkpoints=grid goes with record=false and regret=false"):
        grid(runs, "regret=true")


def test_a_checkpoint_is_named_by_its_steps_or_as_the_best(runs: Path) -> None:
    shutil.copy(runs / "pick" / "policy.pt", runs / "pick" / "checkpoints" / "best.pt")
    pick, first = runs / "pick", step_path(runs / "pick" / "checkpoints", 1000)
    best = pick / "checkpoints" / "best.pt"
    for given, found in (
        (f"policy={pick}@best", f"policy={best}"),
        (f"policies.pick='{pick}@step=1000'", f"policies.pick='{first}'"),
        (f"policy={pick}@step=1000,{pick}@best,expert", f"policy={first},{best},expert"),
        (f"policies={{pick: {pick}@best, place: expert}}", f"policies={{pick: {best}, place: expert}}"),
        ("output=runs/a@best", "output=runs/a@best"),
    ):
        assert with_own_files([given]) == [found]
    config = compose("evaluate", [f"policy={pick}@step=1000"])
    assert isinstance(config, EvaluateConfig) and config.policy == str(first) and config.task.name == "pick"
    (runs / "me@work").mkdir()
    assert with_own_files([f"policy={runs / 'me@work'}"]) == [f"policy={runs / 'me@work'}"]
    for wrong in ("step=5", "step=0", "step=x", "step=", "bset", "best"):
        part = "place" if wrong == "best" else "pick"
        has = "step=500, step=1500" if wrong == "best" else "step=1000, step=2000, best"
        with pytest.raises(ConfigError, match=f"{part}@{wrong}: .*{part}/checkpoints holds no such .* it has {has}$"):
            compose("evaluate", [f"policy={runs / part}@{wrong}"])
