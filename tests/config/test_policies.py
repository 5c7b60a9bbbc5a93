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


@pytest.mark.parametrize(
    ("root", "words", "parts"),
    [
        (
            "evaluate",
            ["task=kitting", "meta_controller=nearest", "policies.meta_controller=runs/c"],
            "pick, place, return",
        ),
        ("evaluate", ["task=cycle", "meta_controller=nearest", "division=one", "policies.pick=expert"], "cycle"),
        (
            "evaluate",
            ["task=sort", "meta_controller=learned", "policies.foo=x"],
            "pick, place, return, meta_controller",
        ),
        ("train_meta_controller", ["policies.foo=expert"], "pick, place, return"),
    ],
)
def test_a_policy_of_no_part_is_refused(root: str, words: list[str], parts: str) -> None:
    with pytest.raises(ConfigError, match=rf"^policies\.\w+ is not used by .*; its parts are {parts}$"):
        compose(root, words)


@pytest.mark.parametrize("words", [["meta_controller=oracle"], ["meta_controller=due", "regret=true"]])
def test_a_live_person_is_in_no_copy(words: list[str]) -> None:
    with pytest.raises(ConfigError, match=r"^human\.motion=live: .* need copies that know what people will do"):
        compose("evaluate", ["task=kitting", "human=live", *words])


OWN_CELL = """
base_height_m: 0.75
places: {tray: {top_m: [0.45, 0.0, 0.1], size_m: [0.3, 0.3]}, shelf: {top_m: [-0.3, 0.4, 0.2], size_m: [0.2, 0.2]}}
objects: {ball: {shape: sphere, size_m: [0.03], arrives_at: tray, belongs_at: shelf}}
"""


@pytest.mark.parametrize("root", ["evaluate", "studio", "export", "deploy"])
@pytest.mark.parametrize("cell", ["paper", "grasp", "bench_hand", "own.yaml"])
def test_a_chosen_cell_takes_nothing_of_the_cell_of_a_run_and_the_arm_follows_it(
    cell: str, root: str, tmp_path: Path
) -> None:
    words = ["task=pick", "cell=varied", "robot=ur5e", "gripper=two_finger", "cell.base_height_m=0.5"]
    save_config(compose("train", words), tmp_path / "config.yaml")
    (tmp_path / "policy.pt").touch()
    (tmp_path / "own.yaml").write_text(OWN_CELL, encoding="utf-8")
    trained = f"policy='{tmp_path}'"
    assert compose_environment(root, [trained]).cell.vary.layouts > 0
    chosen = f"cell='{tmp_path / cell}'" if cell.endswith(".yaml") else f"cell={cell}"
    found = compose_environment(root, [trained, chosen])
    assert found.cell == compose_environment("train", ["task=pick", chosen]).cell
    assert (found.robot.name, found.robot.gripper.name) == ("ur5e", "two_finger")
