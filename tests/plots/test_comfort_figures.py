import csv
import json
import math
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from hrl_comfort.cli import main as commands
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError
from hrl_comfort.evaluation.rollout import path_columns
from hrl_comfort.plots.figure import figure
from hrl_comfort.plots.paths import SHOWN
from tests.cells import SECTION

CONFIG = f"{SECTION}task: {{name: pick_place, max_episode_steps: 200}}\n"
JUMP_STEP = 20


def evaluation(
    folder: Path,
    levels: tuple[int | None, ...] = (1, 4, 7, 10),
    seed: int = 0,
    human: str = "random_walk",
    record: bool = True,
    jump_to: int | None = None,
    episodes: int = 6,
    jump_step: int = JUMP_STEP,
) -> Path:
    """Write an evaluation whose tool keeps 0.1 m + 2 cm a level below 11 off a straight line, and slows down.

    With `jump_to` the tool moves away from the person by 0.1 m/s times the levels it falls.
    """
    rows, paths = [], []
    for level in levels:
        for e in range(episodes):
            rng = np.random.default_rng(e)
            caution = 10 - (level or 5)
            steps = 80 + 3 * caution + e + seed
            when = np.linspace(0, 1, steps + 1)
            bow = 0.02 * caution * np.sin(math.pi * when)
            tool = np.stack([-0.6 + 1.2 * when, 0.1 + bow, 0.3 + 0 * when], axis=1)
            in_force = np.full(steps + 1, level or np.nan)
            if jump_to is not None:
                after = np.maximum(0, np.arange(steps + 1) - jump_step)
                tool[:, 1] += 0.1 * 0.02 * after
                in_force[after > 0] = jump_to
            walk = np.array([0.1 * e, -0.5]) + np.cumsum(rng.normal(0, 0.005, (steps + 1, 2)), axis=0)
            walk[:, 0] += (human == "arc") * 0.3 * when
            gap = np.hypot(*(tool[:, :2] - walk).T)
            rows.append(
                {
                    "train_seed": seed,
                    "episode_seed": 1_000_000 + e,
                    "episode": e,
                    "object": ("orange", "pink")[e % 2],
                    "spawn_id": e % 3,
                    "seen": e % 3 > 0,
                    "comfort_level": "" if level is None or jump_to else level,
                    "human": human,
                    "success": e > 0,
                    "steps": steps,
                    "contact": e == 0,
                    "unsafe_contact": e == 0,
                    "other_collision": "none",
                    "truncated": False,
                    "human_distance_mean_m": gap[1:].mean(),
                    "human_distance_by_path_m": gap[1:].mean(),
                    "tool_path_m": 2.0,
                    "waiting_share": 0.1,
                    "joint_increment_mean_deg": 1.9 - 0.03 * caution,
                }
            )
            for k in range(steps + 1):
                cells = [e, k, 0, "" if level is None else int(in_force[k]), *[0] * 6, *tool[k], *walk[k]]
                paths.append([*cells, 0, gap[k], 0, 0])
    folder.mkdir(parents=True)
    (folder / "config.yaml").write_text(CONFIG)
    with (folder / "episodes.csv").open("w", newline="") as out:
        writer = csv.DictWriter(out, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    if record:
        with (folder / "paths.csv").open("w", newline="") as out:
            csv.writer(out).writerows([path_columns(19), *paths])
    return folder


def draw(output: Path, kind: str, evaluations: list[Path | str], *words: str) -> Path:
    folders = ",".join(f"'{folder}'" for folder in evaluations)
    return figure(compose("figure", [f"kind={kind}", f"evaluations=[{folders}]", f"output='{output}'", *words]))


def size(file: Path) -> tuple[int, int]:
    data = file.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")


@pytest.mark.parametrize("over", ["pairs", "all"])
@pytest.mark.parametrize("kind", ["levels", "speed"])
def test_levels_and_speed_are_drawn_with_their_numbers_beside(tmp_path, kind, over, capsys):
    for seed in (0, 1):
        evaluation(tmp_path / "runs" / str(seed), seed=seed, record=False)
    file = draw(tmp_path / "out" / "f.png", kind, [tmp_path / "runs" / "*"], f"over={over}")
    assert min(size(file)) > 300
    found = json.loads(file.with_suffix(".json").read_text())
    assert (found["levels"], found["train_seeds"]) == ([1, 4, 7, 10], [0, 1])
    change = found["spawns"]["all"]["first_to_last"]["pairs"]["human_distance_mean_m"]
    assert change["percent"] < 0
    assert change["ci95"][0] <= change["percent"] <= change["ci95"][1]
    assert capsys.readouterr().out.startswith("| level |") == (kind == "levels")


def test_an_evaluation_at_one_level_is_drawn(tmp_path):
    evaluation(tmp_path / "one", levels=(5,), record=False)
    assert draw(tmp_path / "f.png", "levels", [tmp_path / "one"]).is_file()


def test_the_plane_has_a_series_a_label(tmp_path):
    one = evaluation(tmp_path / "one", record=False)
    for level in (1, 10):
        evaluation(tmp_path / "ten" / str(level), levels=(level,), record=False)
    file = draw(tmp_path / "f.png", "plane", [one, tmp_path / "ten" / "*"], "labels=[one policy,ten policies]")
    found = json.loads(file.with_suffix(".json").read_text())
    assert {label: each["each"]["levels"] for label, each in found.items()} == {
        "one policy": [1, 4, 7, 10],
        "ten policies": [1, 10],
    }
    # Episode 0 fails: it is in no pair, but it counts in the rates.
    assert found["one policy"]["each"]["spawns"]["all"]["levels"][0]["rates"]["success"]["mean"] < 1
    assert [at["level"] for at in found["ten policies"]["in_common"]] == [1, 10]


def test_evaluations_of_one_label_are_one_series(tmp_path):
    folders = [evaluation(tmp_path / str(level), levels=(level,), record=False) for level in (1, 10)]
    file = draw(tmp_path / "f.png", "plane", folders, "labels=[ten,ten]")
    assert json.loads(file.with_suffix(".json").read_text())["ten"]["each"]["levels"] == [1, 10]


def test_paths_at_four_levels_are_drawn_for_an_object_of_each_kind(tmp_path, monkeypatch):
    drawn = watch(monkeypatch)
    file = draw(tmp_path / "f.png", "paths", [evaluation(tmp_path / "one")])
    assert min(size(file)) > 300
    # Episode 0 is orange and fails.
    assert [axis.get_title(loc="left") for axis in drawn().axes] == [
        "Orange, episode 2 (seen spawn)",
        "Pink, episode 1 (seen spawn)",
    ]
    names = [text.get_text() for text in drawn().axes[0].get_legend().get_texts()]
    assert [name.split(":")[0] for name in names] == ["level 1", "level 4", "level 7", "level 10"]
    assert not file.with_suffix(".json").exists()


def test_paths_of_levels_in_folders_of_their_own_and_chosen_episodes(tmp_path, monkeypatch):
    drawn = watch(monkeypatch)
    folders = [evaluation(tmp_path / str(level), levels=(level,)) for level in (2, 9)]
    draw(tmp_path / "f.png", "paths", folders, "levels=[2,9]", "episodes=[0]")
    (axis,) = drawn().axes
    (first, _) = (text.get_text() for text in axis.get_legend().get_texts())
    assert first.endswith("unsafe contact")


def test_people_are_told_apart_by_their_motion(tmp_path, monkeypatch):
    drawn = watch(monkeypatch)
    folders = [evaluation(tmp_path / name, levels=(None,), human=name) for name in ("random_walk", "arc")]
    draw(tmp_path / "f.png", "people", folders)
    names = [text.get_text().split(":")[0] for text in drawn().axes[0].get_legend().get_texts()]
    assert names == ["random walk", "arc"]


def test_people_at_one_of_several_levels_under_given_names(tmp_path):
    folders = [evaluation(tmp_path / name, human=name) for name in ("random_walk", "arc")]
    words = ("levels=[4]", "labels=[stays,passes by]", "episodes=[1,2]")
    assert draw(tmp_path / "f.png", "people", folders, *words).is_file()


@pytest.mark.parametrize(("column", "cell"), [*product(SHOWN, [None, ""]), ("object", "blue")])
def test_paths_are_drawn_without_what_episodes_lack(tmp_path, monkeypatch, column, cell):
    drawn = watch(monkeypatch)
    folder = evaluation(tmp_path / "one", levels=(5,))
    table = pd.read_csv(folder / "episodes.csv")
    table = table.drop(columns=column) if cell is None else table.assign(**{column: cell})
    table.to_csv(folder / "episodes.csv", index=False)
    draw(tmp_path / "f.png", "people", [folder], "labels=[one]")
    axis, title = drawn().axes[0], "Orange, episode 2"
    if column == "object":
        title = "Blue, episode 1" if cell else "Object, episode 1"
    (name,) = (text.get_text() for text in axis.get_legend().get_texts())
    assert axis.get_title(loc="left").startswith(title)
    assert ("steps" in name, " m" in name) == (column != "steps", column != "human_distance_mean_m")
    assert "nan" not in name.lower() and "<na>" not in name.lower()


def test_the_jump_is_measured_one_second_later(tmp_path):
    without = evaluation(tmp_path / "without", levels=(10,), episodes=9)
    jumping = evaluation(tmp_path / "with", levels=(10,), jump_to=1, episodes=9)
    file = draw(tmp_path / "f.png", "jump", [without, jumping], "jump_s=0.4")
    assert min(size(file)) > 300
    found = json.loads(file.with_suffix(".json").read_text())
    assert (found["episodes_at_jump"], found["episodes"]) == (9, 9)
    assert found["success"] == {"without": pytest.approx(8 / 9), "with": pytest.approx(8 / 9)}
    assert found["tools_apart_before_m"] == 0
    # The person stands some way to the side, so of the 10 cm that the tool has moved a little less counts.
    effect = found["human_distance_m"]
    assert effect["ci95"][0] <= effect["difference"] <= effect["ci95"][1]
    assert 0.04 < effect["difference"] < 0.1
    assert effect["with"] - effect["without"] == pytest.approx(effect["difference"])


def test_episodes_that_end_before_the_second_is_over_leave_no_number(tmp_path):
    jumps = (("a", None), ("b", 1))
    folders = [evaluation(tmp_path / name, levels=(10,), jump_to=to, jump_step=60) for name, to in jumps]
    file = draw(tmp_path / "f.png", "jump", folders, "jump_s=1.2")
    found = json.loads(file.with_suffix(".json").read_text())
    assert found["episodes"] == 0
    assert "human_distance_m" not in found


def test_a_jump_at_another_time_or_the_other_way_round_is_refused(tmp_path):
    without = evaluation(tmp_path / "without", levels=(10,))
    jumping = evaluation(tmp_path / "with", levels=(10,), jump_to=1)
    with pytest.raises(ConfigError, match=r"jump_s=1: .*changes at 0.42 s"):
        draw(tmp_path / "f.png", "jump", [without, jumping], "jump_s=1")
    with pytest.raises(ConfigError, match="must keep one level"):
        draw(tmp_path / "f.png", "jump", [jumping, without], "jump_s=0.4")
    with pytest.raises(ConfigError, match=r"jump_s=0.4: .*does not change by then"):
        draw(tmp_path / "f.png", "jump", [without, evaluation(tmp_path / "calm", levels=(10,))], "jump_s=0.4")


@pytest.mark.parametrize(
    ("kind", "words", "says"),
    [
        ("levels", ["evaluations=[NO]"], "is not the folder of an evaluation"),
        ("levels", ["evaluations=[EMPTY]"], "holds no episodes.csv"),
        ("levels", ["evaluations=[PLAIN]"], "comfort_level=''"),
        ("levels", ["evaluations=[ONE,ONE]"], "twice"),
        ("levels", ["evaluations=[]"], "must name at least 1"),
        ("levels", ["over=some"], "over='some' is not allowed; choose one of pairs, all"),
        ("plane", ["labels=[a,b]"], "must be as many as evaluations"),
        ("paths", ["levels=[3]"], "no episode at level 3"),
        ("paths", ["episodes=[77]"], "77 is not in"),
        ("paths", ["episodes=[1,2,3]"], "one or two"),
        ("paths", ["evaluations=[BARE]"], "evaluate with record=true"),
        ("people", [], "holds the levels 1, 4, 7, 10; choose one"),
        ("people", ["levels=[1,4]"], "must be one level"),
        ("jump", [], "jump_s=null"),
        ("jump", ["jump_s=1"], "needs two evaluations"),
        ("jump", ["jump_s=1", "evaluations=[PLAIN,BARE]"], "no paths.csv"),
        ("jump", ["jump_s=30", "evaluations=[PLAIN,PLAIN2]"], "no episode of both evaluations lasts so long"),
        ("jump", ["jump_s=1", "evaluations=[PLAIN,PLAIN]"], "must be two"),
        ("jump", ["jump_s=1", "evaluations=[ONE,PLAIN]"], "is there twice"),
    ],
)
def test_bad_input_gets_one_line(folders, tmp_path, capsys, kind, words, says):
    words = [f"kind={kind}", "evaluations=[ONE]", f"output={tmp_path}/f.png", *words]
    for name in sorted(folders, key=len, reverse=True):
        words = [word.replace(name, str(folders[name])) for word in words]
    assert commands.main(["figure", *words]) == 1
    out, error = capsys.readouterr()
    assert says in error
    assert error.count("\n") == 1
    assert "Traceback" not in out + error
    assert not (tmp_path / "f.png").exists()


def test_a_folder_without_the_time_limit_is_named(tmp_path):
    folder = evaluation(tmp_path / "one", record=False)
    (folder / "config.yaml").write_text("task: {name: pick}\n")
    with pytest.raises(ConfigError, match=r"config.yaml lacks task.max_episode_steps"):
        draw(tmp_path / "f.png", "levels", [folder])


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    root = tmp_path_factory.mktemp("evaluations")
    (root / "empty").mkdir()
    return {
        "NO": root / "nowhere",
        "EMPTY": root / "empty",
        "ONE": evaluation(root / "one", episodes=3),
        "BARE": evaluation(root / "bare", record=False, episodes=3),
        "PLAIN": evaluation(root / "plain", levels=(None,), episodes=3),
        "PLAIN2": evaluation(root / "other", levels=(None,), episodes=3),
    }


def watch(monkeypatch):
    """Return a function that returns the figure drawn last."""
    from hrl_comfort.plots import paths as comfort_paths

    drawn, draw_it = [], comfort_paths._draw
    monkeypatch.setattr(comfort_paths, "_draw", lambda *a: drawn.append(draw_it(*a)) or drawn[-1])
    return lambda: drawn[-1]
