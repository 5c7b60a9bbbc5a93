"""Cells that users bring: a file of their own is all that it takes, and what cannot be is said in one line."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from hrl_comfort.composition.compose import compose, compose_environment, plain_value
from hrl_comfort.config import ConfigError
from hrl_comfort.config.overrides import check_overrides
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.files.run_config import load_config, save_config
from hrl_comfort.scene.layout import layout_warnings
from hrl_comfort.scene.workcell import build_scene
from hrl_comfort.sim.engine import Engine

PAGE = Path(__file__).parents[2] / "docs" / "bring_your_own.md"
BUILT_IN = {"paper": "ur3e", "bench": "ur3e", "station": "ur10e"}


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the cell of the page: five places, two obstacles, three kinds of objects."""
    text = re.search(r"```yaml\n(# hall\.yaml\n.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert text is not None and len(text[1].splitlines()) <= 40
    file = tmp_path_factory.mktemp("cell") / "hall.yaml"
    file.write_text(text[1])
    return file


def test_the_scripted_expert_works_in_a_cell_of_a_users_own_file(hall: Path) -> None:
    words = [f"cell='{hall}'", "task=cycle", "policy=expert", "human=none", "split=validation", "episodes=12"]
    config = compose("evaluate", words)
    assert (len(config.cell.places), len(config.cell.obstacles), config.cell.kinds) == (5, 2, ("ball", "cube", "tool"))
    assert not list(layout_warnings(config))
    table = rollout(config).table
    assert table["success"].all() and set(table["object"]) == {"ball", "cube", "tool"}


def test_every_kind_arrives_in_its_slots_and_belongs_at_its_place(hall: Path) -> None:
    env = compose_environment("train", [f"cell='{hall}'", "task=sort", "task.objects=3", "human=none"])
    state, cell = Engine(env, 30, 0).reset(), env.cell
    assert state.kinds.unique().tolist() == [0, 1, 2]
    assert torch.equal(
        state.layout[0, :5, :3], torch.tensor([each.top_m for each in cell.places.values()], dtype=torch.float64)
    )
    heights = torch.tensor([0.03, 0.03, 0.07], dtype=torch.float64)
    torch.testing.assert_close(state.objects[..., 2], 0.10 + heights[state.kinds], atol=1e-12, rtol=0)
    for index, (kind, each) in enumerate(cell.objects.items()):
        assert state.kind_places[0, index].tolist() == cell.centre(kind, each.belongs_at)
    slots = (state.objects[..., 0] - 0.45).sort(dim=1).values
    torch.testing.assert_close(slots, torch.tensor([[-0.1, 0.0, 0.1]]).double().expand(30, 3), atol=0.006, rtol=0)


def test_an_object_whose_kind_changes_arrives_at_the_place_of_its_new_kind(hall: Path) -> None:
    words = [f"cell='{hall}'", "cell.objects.tool.arrives_at=spare", "task=shift", "task.objects=1", "human=none"]
    engine = Engine(compose_environment("train", words), 20, 0)
    state = engine.reset()
    (spare,) = torch.where(state.target_kind == 2)[0][:1].tolist()
    np.testing.assert_allclose(state.objects[spare, 0, :2], [-0.35, -0.35], atol=0.005)
    (belt,) = torch.where(state.target_kind == 0)[0][:1].tolist()
    arrivals = torch.from_numpy(engine.episodes.draw.arrivals)
    assert not torch.equal(arrivals[belt, 0, 0], arrivals[belt, 0, 2])
    assert torch.equal(state.target_object[belt], arrivals[belt, 0, 0])


@pytest.mark.parametrize("name", BUILT_IN)
@pytest.mark.parametrize("task", ["pick", "place", "return", "cycle", "sort"])
def test_the_built_in_cells_pass_the_checks_and_begin(name: str, task: str) -> None:
    words = [f"cell={name}", f"robot={BUILT_IN[name]}", f"task={task}"]
    assert not list(layout_warnings(compose("train", words)))
    engine = Engine(compose_environment("train", words), 4, 0)
    assert not engine.reset().table_collision.any()
    engine.close()


@pytest.mark.parametrize("name", ["bench", "station"])
def test_the_scripted_expert_works_in_the_built_in_cells(name: str) -> None:
    words = [f"cell={name}", f"robot={BUILT_IN[name]}", "task=cycle", "policy=expert", "human=none", "episodes=8"]
    assert rollout(compose("evaluate", [*words, "split=validation"])).table["success"].all()


def test_a_run_keeps_its_cell(hall: Path, tmp_path: Path) -> None:
    config = compose("train", [f"cell='{hall}'", f"output='{tmp_path}'"])
    save_config(config, tmp_path / "config.yaml")
    assert load_config(tmp_path).cell == config.cell
    (tmp_path / "policy.pt").touch()
    assert compose("evaluate", [f"policy='{tmp_path}'", "task=pick"]).cell == config.cell


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            "cell=attic.yaml",
            "cell=attic.yaml: there is no such file; give one, or choose one of bench, bench_hand, grasp, grasp_varied",
        ),
        ("cell.objects.cube.arrives_at=attic", "arrives_at='attic' is not allowed; choose one of ball_table, orange"),
        ("cell.places.rack.hight=2", "cell.places.rack has legs, size_m, slots_m, top_m, yaw_deg"),
        ("cell.places.ball_table.legs=3", "legs=3 is not allowed; choose one of 0, 1, 4"),
        ("cell.objects.orange.size_m=[1,2]", "size_m=[1.0, 2.0] has 2 numbers; shape=sphere takes 1"),
        ("cell.obstacles={a-b:{shape:box,position_m:[0,1,0],size_m:[1,1,1]}}", "'a-b' is not a name"),
        ("cell.stations_m=[]", "cell.stations_m"),
        ("task.object=cube", "task.object='cube' is not allowed; choose one of random, orange, pink"),
        ("task=sort task.objects=7", "task.objects=7, but cell.places.ball_table.slots_m has 6; add slots"),
    ],
)
def test_what_a_cell_cannot_have_is_said_in_one_line(words: str, says: str) -> None:
    new = "cell.objects.cube={shape:box,size_m:[0.03,0.03,0.03],arrives_at:ball_table,belongs_at:pink_table}"
    with pytest.raises(ConfigError, match=re.escape(says)) as error:
        compose("train", [*([new] if "cube.arrives" in words else []), *words.split()])
    assert "\n" not in str(error.value)


def test_a_file_of_a_cell_that_varies_says_how_and_gives_no_key_twice(tmp_path: Path) -> None:
    shown = compose("train", ["cell=varied"]).cell
    content = yaml.safe_dump({**plain_value(shown), "vary": {"layouts": 7}})
    (tmp_path / "own.yaml").write_text(content, encoding="utf-8")
    assert compose("train", [f"cell='{tmp_path}/own.yaml'"]).cell.vary.layouts == 7
    (tmp_path / "own.yaml").write_text(f"{content}\nvary: {{layouts: 8}}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"own\.yaml.*gives vary again"):
        compose("train", [f"cell='{tmp_path}/own.yaml'"])


def test_a_mapping_that_is_set_replaces_what_was_there_and_an_entry_joins_it() -> None:
    tray = "{top_m:[0,0.5,0.1],size_m:[0.2,0.2]}"
    assert list(compose("train", [f"cell.places.tray={tray}"]).cell.places)[-2:] == ["pink_table", "tray"]
    ball = "{shape:sphere,size_m:[0.03],arrives_at:tray,belongs_at:tray}"
    cell = compose("train", [f"cell.places={{tray:{tray}}}", f"cell.objects={{ball:{ball}}}"]).cell
    assert (list(cell.places), cell.kinds) == (["tray"], ("ball",))


def test_obstacles_are_touched_and_end_an_episode() -> None:
    words = ["cell.obstacles.wall={shape:box,position_m:[0.3,0,0.4],size_m:[0.02,0.5,0.3]}", "task=pick", "human=none"]
    env = compose_environment("train", words)
    assert build_scene(env.robot, env.cell, 2).still[3] == "obstacle_wall"
    engine = Engine(env, 1, 0)
    state = engine.reset()
    for _ in range(60):
        result = engine.step(np.array([[0.0, 1.0, 0.0, 0.0, 0.0, 0.0]]))
        state = result.state
        if result.done[0]:
            break
    assert state.table_collision[0] and result.failed[0]


def test_a_sweep_takes_built_in_cells_alone(hall: Path) -> None:
    assert check_overrides("train", ["cell=paper,bench"], sweep=True) == ["cell=paper,bench"]
    with pytest.raises(ConfigError, match=r"hall.yaml.* is not a choice"):
        check_overrides("train", [f"cell='{hall}',bench"], sweep=True)
