"""Words of the command line that stand for policies."""

from __future__ import annotations

from pathlib import Path

import pytest

from hrl_comfort.composition.compose import compose, compose_environment
from hrl_comfort.composition.policies import check_beside, options_in, with_defaults
from hrl_comfort.config import ConfigError, StudioConfig
from hrl_comfort.files.run_config import save_config


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
        "meta_controller.options=['pick','place','return']", "meta_controller=nearest", "task=cycle",
    ]  # fmt: skip
    assert with_defaults(["policy=random"]) == ["policy=random"]


def test_a_second_policy_of_another_task_is_refused_by_its_key(tmp_path: Path) -> None:
    for name in ("pick", "place", "return"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "policy.pt").touch()
        save_config(compose("train", [f"task={name}"]), tmp_path / name / "config.yaml")

    def check(task: str, beside: str) -> None:
        config = compose("studio", [f"task={task}", "policy=expert", f"beside='{beside}'"])
        assert isinstance(config, StudioConfig)
        check_beside(config)

    for task, beside in {"pick": tmp_path / "pick", "cycle": tmp_path, "reach": "expert"}.items():
        check(task, str(beside))
    with pytest.raises(ConfigError, match=r"^beside='.*pick' was trained for pick, and the cells have task=cycle"):
        check("cycle", str(tmp_path / "pick"))
    with pytest.raises(ConfigError, match=r"^beside='.*' was trained for the chain pick, place, return, and the cells"):
        check("pick", str(tmp_path))


@pytest.mark.parametrize(("task", "tolerances_m"), [("pick_place", (0.3, 0.3)), ("place_fine", (0.3, 0.005))])
def test_a_task_takes_from_a_run_all_nested_keys_but_those_that_its_own_file_sets(
    task: str, tolerances_m: tuple[float, float]
) -> None:
    run = Path(__file__).parents[2] / "runs" / "reference" / "comfort" / "stages" / "seed0"
    found = compose_environment("evaluate", [f"policy={run}", f"task={task}"]).task.precision
    assert (found.grasp_tolerance_m, found.place_tolerance_m) == tolerances_m


@pytest.mark.parametrize("cell", ["paper", "bench", "grasp"])
def test_a_chosen_cell_takes_nothing_of_the_cell_of_a_run(cell: str, tmp_path: Path) -> None:
    save_config(compose("train", ["task=pick", "cell=varied", "cell.base_height_m=0.5"]), tmp_path / "config.yaml")
    (tmp_path / "policy.pt").touch()
    assert compose_environment("evaluate", [f"policy='{tmp_path}'"]).cell.vary.layouts > 0
    found = compose_environment("evaluate", [f"policy='{tmp_path}'", f"cell={cell}"]).cell
    assert found == compose_environment("evaluate", [f"cell={cell}", "policy=expert"]).cell
