"""The benchmark: what its entry says, and what it lets a policy change."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hrl_comfort.analysis.mixes import IDLE, best_mix
from hrl_comfort.benchmarks import entries, returns, suite, throughput
from hrl_comfort.cli.first_checks import completed
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import BenchmarkConfig, ConfigError, EvaluateConfig
from hrl_comfort.files.run_config import save_config

SHORT = ("split=validation", "episodes=2", "levels=[1,10]", "task.max_episode_steps=150")


def asked(*overrides: str) -> BenchmarkConfig:
    config = compose("benchmark", completed("benchmark", list(overrides)))
    assert isinstance(config, BenchmarkConfig)
    return config


def part(*overrides: str, task: str = "shift") -> EvaluateConfig:
    return asked(*overrides).parts[task]


def test_one_policy_stands_for_every_skill_and_a_folder_for_those_in_it(tmp_path: Path) -> None:
    assert asked("policy=expert").policies == dict.fromkeys(("pick", "place", "return"), "expert")
    for name in ("pick", "place", "return"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "policy.pt").touch()
    config = asked(str(tmp_path))
    assert config.policies == {name: os.path.join(tmp_path, name) for name in ("pick", "place", "return")}
    assert suite.name_of(config.parts["kitting"]) == str(tmp_path)
    assert suite.name_of(part("policy=random")) == "random"


def test_the_suite_is_two_tasks_in_one_cell_each_beside_its_people() -> None:
    parts = asked("policy=expert").parts
    assert {name: (each.task.name, each.human.motion) for name, each in parts.items()} == {
        "kitting": ("kitting", "fetcher"), "shift": ("shift", "mixture"),
    }  # fmt: skip
    for each in parts.values():
        assert (each.split, each.episodes, each.levels) == ("test", 48, [1, 4, 7, 10])
        assert (each.robot.rating, each.safety.kind, each.safety.clearance_m) == ("collaborative", "ssm", 0.01)
        assert (each.task.terminate_on, each.task.arrival_speed_rad_s) == ("unsafe_contact", 0.5)
        assert (each.task.max_step_deg, each.task.max_episode_steps) == (1.4, 3000)
        assert list(each.cell.places) == ["left", "middle", "right"] and each.human.partitioned
    assert list(asked("suite=[shift]").parts) == ["shift"]
    assert asked("suite=[shift]", "task.objects=2").parts["shift"].task.objects == 2  # kitting has six
    assert {each.human.motion for each in asked("human=still").parts.values()} == {"still"}


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["suite=[cycle]"], r"suite=\['cycle'\] must name one or several of kitting, shift"),
        (["suite=[shift,shift]"], r"must name one or several of kitting, shift"),
        (["suite=[]"], r"suite=\[\] must name one or several"),
        (["suite=shift"], r"suite='shift' must name one or several of kitting, shift: suite=\[kitting,shift\]"),
        (["task=cycle"], r"task=cycle does not go with the benchmark; choose among its tasks by suite="),
    ],
)
def test_another_task_than_the_suites_is_refused(words: list[str], reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        asked("policy=expert", *words)


def test_an_entry_says_what_it_changed_of_the_suite() -> None:
    config = part("policy=expert", "output=elsewhere", "suite=[shift]")
    assert suite.changed(config) == {}
    assert suite.changed(part("policy=expert", "task.observation=sight", task="kitting")) == {}
    other = part("policy=expert", "split=validation", "human=still", "safety=none")
    assert {"split", "human.motion", "safety.kind"} <= set(suite.changed(other))
    assert suite.changed(replace(config, episodes=3)) == {"episodes": 3}


def test_the_top_and_the_level_told_belong_to_the_entry() -> None:
    words = ("policy=expert", "meta_controller=cautious", "meta_controller.level_override=[3]")
    config = part(*words, task="kitting")
    assert suite.changed(config) == {} and suite.top_of(config)["meta_controller.max_waits"] == 6
    assert suite.changed(part("policy=expert", "meta_controller.interruption_steps=20", task="kitting")) == {}
    said = "expert meta_controller.name='cautious' meta_controller.level_override=[3] meta_controller.max_waits=6"
    assert suite.name_of(config) == said
    assert suite.changed(part("policy=expert", "meta_controller.time_limit_steps=7")) != {}
    learned = part("policy=expert", "meta_controller=learned", "policies.meta_controller=runs/top")
    assert suite.changed(learned) == {} and suite.name_of(learned).startswith("expert meta_controller.name='learned'")
    assert suite.name_of(learned).endswith(" runs/top")


def test_a_top_that_does_not_fit_a_part_is_refused_before_any_runs(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"^meta_controller\.order='pick_99' is not allowed"):
        suite.benchmark(asked("policy=random", "meta_controller=fixed", "meta_controller.order=[pick_99]", *SHORT,
                              f"output='{tmp_path / 'entry'}'"))  # fmt: skip
    assert not (tmp_path / "entry").exists()


def test_a_policy_trained_with_other_steps_is_refused(tmp_path: Path) -> None:
    for name in ("pick", "place", "return"):
        (tmp_path / name).mkdir()
        save_config(compose("train", [f"task={name}"]), tmp_path / name / "config.yaml")
        (tmp_path / name / "policy.pt").touch()
    with pytest.raises(ConfigError, match=r"task\.max_step_deg=1\.4, but policies\.pick=.* was trained with 2"):
        suite.benchmark(asked(str(tmp_path), f"output='{tmp_path / 'entry'}'"))
    with pytest.raises(ConfigError, match=r"policies\.pick=.*policy\.pt' was trained with 2"):
        suite.check_steps(part("policy=expert"), "policies.pick", str(tmp_path / "pick" / "policy.pt"))
    assert not (tmp_path / "entry").exists()


def test_an_entry_has_a_part_for_each_task_tables_and_a_figure_with_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(suite, "ENTRIES", tmp_path / "entries")
    first = suite.benchmark(asked("policy=random", *SHORT, f"output='{tmp_path / 'first'}'"))
    entry = json.loads(first.read_text(encoding="utf-8"))
    assert list(entry["parts"]) == ["kitting", "shift"]
    for name, levels in entry["parts"].items():
        assert [(at["level"], at["shifts"]) for at in levels] == [(1, 2), (10, 2)]
        assert levels[0]["discomfort_per_min"]["mean"] > levels[1]["discomfort_per_min"]["mean"]
        assert ("orders_missed_per_min" in levels[0]) == (name == "kitting")
        assert (tmp_path / "first" / name / "episodes.csv").is_file()
    assert entry["changed"]["split"] == "validation" and entry["policies"]["pick"] == "random"
    assert entry["top"]["meta_controller.name"] == "nearest"
    (tmp_path / "entries" / "random").mkdir(parents=True)
    first.rename(tmp_path / "entries" / "random" / entries.FILE)
    second = suite.benchmark(
        asked("policy=random", "meta_controller=idle", "suite=[shift]", *SHORT, f"output='{tmp_path / 'second'}'")
    )
    text = second.with_suffix(".md").read_text(encoding="utf-8")
    assert re.findall(r"^(kitting|shift)$|^\| (random[^|]*) \| ", text, re.MULTILINE) == [
        ("kitting", ""), *[("", "random*")] * 2,
        ("shift", ""), *[("", "random*")] * 2, *[("", "random meta_controller.name='idle'*")] * 2,
    ]  # fmt: skip
    assert "orders filled a minute" in text and "objects a minute" in text
    assert second.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    alone = json.loads(second.read_text(encoding="utf-8"))["parts"]["shift"]
    assert all(at["objects_per_min"]["mean"] == at["avoidable_discomfort_per_min"]["mean"] == 0.0 for at in alone)


def write_seeds(
    folder: Path, rates: list[list[float]], mood: float = 0.0, changed: str = "", cost: float = 1.0
) -> Path:
    """Write entries, one a training seed, of the objects a minute at each level.

    A person's rating falls with them, and each costs as much avoidable discomfort.
    """
    folder.mkdir(parents=True)
    for seed, each in enumerate(rates):
        levels = [
            {
                "level": 1 + 9 * number if len(each) > 1 else None,
                "shifts": 16,
                **{
                    name: {"mean": count, "ci95": None}
                    for name in (*entries.ANSWERS, "discomfort_per_min", "unsafe_contacts_per_h")
                },
                "avoidable_discomfort_per_min": {"mean": cost * count, "ci95": None},
                "person_rating_mean": {"mean": 10 - count / 2 + mood, "ci95": None},
            }
            for number, count in enumerate(each)
        ]
        entry = {
            "policy": str(seed),
            "policies": {"pick": f"run@{seed}"},
            "changed": {"human.motion": changed} if changed else {},
            "parts": {"shift": levels},
        }
        (folder / str(seed)).mkdir()
        (folder / str(seed) / entries.FILE).write_text(json.dumps(entry), encoding="utf-8")
    return folder


def cells_of(table: str) -> list[list[str]]:
    return [line.strip("| ").split(" | ") for line in table.splitlines()[2:]]


def test_a_folder_of_seeds_is_one_entry_with_intervals_over_seeds(tmp_path: Path) -> None:
    write_seeds(tmp_path / "ours", [[4.0, 10.0], [5.0, 12.0], [6.0, 14.0]])
    shutil.copytree(tmp_path / "ours" / "0", tmp_path / "alone")
    alone, ours = entries.committed(tmp_path).values()
    assert (alone["policy"], ours["policy"]) == ("alone", "ours, 3 seeds")
    low, high = ours["parts"]["shift"]
    # Student's t with two degrees of freedom: 4.303 standard errors of 1 / sqrt(3).
    assert low["objects_per_min"] == {"mean": 5.0, "ci95": pytest.approx([5 - 2.484, 5 + 2.484], abs=1e-3)}
    assert (low["shifts"], high["level"], high["objects_per_min"]["mean"]) == (48, 10, 12.0)
    assert cells_of(entries.table("shift", [ours]))[1][:4] == ["ours, 3 seeds", "10", "48", "12.00 [7.03, 16.97]"]


def test_entries_of_a_folder_that_differ_in_the_suite_are_refused(tmp_path: Path) -> None:
    write_seeds(tmp_path / "ours", [[4.0, 10.0]], changed="still")
    write_seeds(tmp_path / "other", [[4.0, 10.0], [5.0, 12.0]])
    (tmp_path / "ours" / "0").rename(tmp_path / "other" / "2")
    with pytest.raises(ConfigError, match="must be of the same levels, the same top and the same suite"):
        entries.pooled(tmp_path / "other")


def test_an_entry_that_lacks_a_quantity_is_to_be_measured_again(tmp_path: Path) -> None:
    file = write_seeds(tmp_path / "ours", [[4.0, 10.0]]) / "0" / "benchmark.json"
    said = json.loads(file.read_text(encoding="utf-8"))
    for level in said["parts"]["shift"]:
        level.pop("tool_speed_beside_m_s", None)
    file.write_text(json.dumps(said), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"^an entry lacks tool_speed_beside_m_s; measure it again$"):
        entries.responses("shift", tmp_path / "ours")


def test_an_interval_of_a_rate_is_not_below_zero(tmp_path: Path) -> None:
    write_seeds(tmp_path / "ours", [[0.0], [0.0], [6.0]])
    assert entries.pooled(tmp_path / "ours")["parts"]["shift"][0]["objects_per_min"]["ci95"][0] == 0.0


def test_levels_are_compared_with_each_other_seed_by_seed(tmp_path: Path) -> None:
    ours = write_seeds(tmp_path / "ours", [[4.0, 10.0], [5.0, 12.5]])
    *_, row = cells_of(entries.responses("shift", ours))
    assert row == ["objects a minute", "4.50 [-1.85, 10.85]", "11.25 [-4.63, 27.13]", "150.0"]
    still = write_seeds(tmp_path / "still", [[0.0, 10.0], [5.0, 12.5]])
    assert cells_of(entries.responses("shift", still))[-1][-1] == "–"


def test_a_person_beside_a_robot_that_is_told_is_compared_at_the_same_throughput(tmp_path: Path) -> None:
    fixed = write_seeds(tmp_path / "fixed", [[4.0, 10.0], [5.0, 12.0]])
    told = write_seeds(tmp_path / "told", [[7.0], [9.0]], mood=0.25, changed="fitted")
    idle = write_seeds(tmp_path / "idle", [[0.0]]) / "0"
    (row,) = cells_of(throughput.of_a_told_robot("shift", told, fixed, idle))
    assert row == [*["8.00 [-4.71, 20.71]"] * 2, "6.25 [-0.10, 12.60]", "6.00 [-0.35, 12.35]", "0.25"]
    assert [line[:2] for line in cells_of(entries.table("shift", [*entries.committed(tmp_path).values()]))][-1] == [
        "told, 2 seeds*",
        "–",
    ]
    # A seed that does 14 rests for two sevenths of the time, rated 10 then, beside a level that does 10.
    fast = write_seeds(tmp_path / "fast", [[14.0], [6.0]], changed="fitted")
    (row,) = cells_of(throughput.of_a_told_robot("shift", fast, fixed, idle))
    assert [each.split()[0] for each in row] == ["10.00", "8.00", "6.00", "6.00", "0.00"]


def test_an_entry_is_compared_with_the_best_mix_of_rivals_at_equal_throughput(tmp_path: Path) -> None:
    ours = write_seeds(tmp_path / "ours", [[4.0, 10.0], [5.0, 12.0]])
    seeded = write_seeds(tmp_path / "seeded", [[8.0, 12.0], [8.0, 12.0], [99.0, 99.0]], cost=2.0)
    scripted = write_seeds(tmp_path / "scripted", [[10.0, 11.0]], cost=1.6) / "0"
    low, high = cells_of(throughput.of_rivals("shift", ours, [seeded, scripted]))
    # At level 1 a mix of rest and the scripted rival costs 1.6 an object; at level 10 one seed does more than both.
    assert low == ["1", *["4.50 [-1.85, 10.85]"] * 3, "7.20 [-2.96, 17.36]", "-2.70 [-6.51, 1.11]", "-37.5"]
    assert high[0] == "10" and float(high[4].split()[0]) == pytest.approx((1.6 * 10 + 24.0) / 2)
    # A seed that does 12 rests for a twelfth of the time beside a rival that does 11.
    alone = cells_of(throughput.of_rivals("shift", ours, [scripted]))[1]
    assert [each.split()[0] for each in alone[1:]] == ["11.00", "10.50", "10.50", "16.80", "-6.30", "-37.5"]
    (write_seeds(tmp_path / "seven", [[1.0, 1.0]]) / "0").rename(tmp_path / "seven" / "7")
    with pytest.raises(ConfigError, match=r"ours has no training seed in common with its rivals"):
        throughput.of_rivals("shift", ours, [tmp_path / "seven"])
    with pytest.raises(ConfigError, match=r"the entry of '0' has no part kitting; it has shift"):
        throughput.of_rivals("kitting", ours, [scripted])
    short = write_seeds(tmp_path / "short", [[8.0]]) / "0"
    with pytest.raises(ConfigError, match=r"level 1 was not measured"):
        throughput.of_rivals("shift", ours, [short])
    with pytest.raises(ConfigError, match=r"the person's own level was not measured"):
        throughput.of_a_told_robot("shift", ours, ours, scripted)


def test_a_return_is_compared_with_that_of_the_best_rival_at_each_level(tmp_path: Path) -> None:
    def kitting(name: str, orders: list[list[float]], missed: float, cost: float) -> Path:
        folder = write_seeds(tmp_path / name, orders, cost=cost)
        for file in folder.rglob(entries.FILE):
            entry = json.loads(file.read_text(encoding="utf-8"))
            rows = [{**row, "orders_missed_per_min": {"mean": missed, "ci95": None}} for row in entry["parts"]["shift"]]
            file.write_text(json.dumps({**entry, "parts": {"kitting": rows}}), encoding="utf-8")
        return folder

    ours = kitting("ours", [[4.0, 10.0], [5.0, 12.0]], missed=2.0, cost=0.5)
    slow = kitting("slow", [[4.0, 4.0], [4.0, 4.0]], missed=3.0, cost=0.25)
    fast = kitting("fast", [[9.0, 9.0]], missed=1.0, cost=2.0) / "0"
    # With a price of 0.4: 0.8 of an order less 1; `slow` 3.6 less 1.5; `fast` 1.8 less 0.5.
    low, high = cells_of(returns.of_rivals(0.4, ours, [slow, fast]))
    assert [each.split()[0] for each in low] == ["1", "2.60", "2.10", "0.50", "23.8", "`slow`"]
    assert [each.split()[0] for each in high] == ["10", "7.80", "2.10", "5.70", "271.4", "`slow`"]
    assert cells_of(returns.of_rivals(0.0, ours, [slow, fast]))[0][-1] == "`0`"
    with pytest.raises(ConfigError, match=r"^one was not measured at level 1, but at None$"):
        returns.of_rivals(0.4, ours, [kitting("one", [[4.0]], missed=3.0, cost=0.25)])
    with pytest.raises(ConfigError, match=r"has no part kitting; it has shift"):
        returns.of_rivals(0.4, write_seeds(tmp_path / "shift", [[4.0, 10.0]]), [slow])


def test_rivals_that_one_name_would_make_one_are_refused_before_they_are_read() -> None:
    for ours, rivals in (("ours", ["a/slow", "b/slow"]), ("slow", ["fast", "b/slow"])):
        with pytest.raises(ConfigError, match=r"^slow is the name of 2 folders, but names the best rival; rename one$"):
            returns.of_rivals(0.4, Path(ours), [*map(Path, rivals)])


def test_an_entry_without_avoidable_discomfort_is_not_compared(tmp_path: Path) -> None:
    old = write_seeds(tmp_path / "old", [[4.0]])
    file = old / "0" / entries.FILE
    text = file.read_text(encoding="utf-8").replace("avoidable_discomfort", "some_discomfort")
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"the entry of '0' has no avoidable_discomfort_per_min; measure it again"):
        throughput.of_rivals("shift", old, [old])


def test_the_best_mix_passes_over_a_level_that_two_others_beat() -> None:
    points = [(0.0, 10.0), (5.0, 4.0), (10.0, 6.0)]
    assert best_mix(points, 5.0) == best_mix(points[::2], 5.0) == 8.0
    assert best_mix(points, 10.0) == 6.0 and best_mix(points, 10.1) is None


def test_the_least_discomfort_of_mixes_is_the_lower_convex_hull() -> None:
    points = [IDLE, (2.0, 5.0), (4.0, 4.0), (8.0, 16.0), (6.0, 15.0)]
    assert [best_mix(points, x, min) for x in (0.0, 2.0, 4.0, 6.0, 8.0)] == [0.0, 2.0, 4.0, 10.0, 16.0]


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda entry: entry.pop("parts"), "parts"),
        (lambda entry: entry.update(parts={}), "parts"),
        (lambda entry: entry.update(parts={"shift": []}), "shift"),
        (lambda entry: entry["parts"]["shift"][0].pop("discomfort_per_min"), "discomfort_per_min"),
        (lambda entry: entry["parts"]["shift"][0]["objects_per_min"].update(mean=None), "mean"),
    ],
)
def test_a_damaged_entry_is_named_in_one_line_before_anything_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damage: Callable[[dict[str, Any]], Any], reason: str
) -> None:
    file = write_seeds(tmp_path / "ours", [[4.0, 10.0]]) / "0" / entries.FILE
    entry = json.loads(file.read_text(encoding="utf-8"))
    damage(entry)
    file.write_text(json.dumps(entry), encoding="utf-8")
    monkeypatch.setattr(suite, "ENTRIES", tmp_path)
    with pytest.raises(ConfigError, match=rf"ours/0/benchmark\.json is damaged: .*{reason}"):
        suite.benchmark(asked("policy=random", *SHORT, f"output='{tmp_path / 'mine'}'"))
    assert not (tmp_path / "mine").exists()


def test_a_folder_without_an_entry_is_left_out_and_two_copies_of_a_seed_are_refused(tmp_path: Path) -> None:
    (tmp_path / "begun" / "0").mkdir(parents=True)
    assert entries.committed(tmp_path) == {}
    with pytest.raises(ConfigError, match="begun holds no entry"):
        entries.pooled(tmp_path / "begun")
    ours = write_seeds(tmp_path / "ours", [[4.0, 10.0]])
    shutil.copytree(ours / "0", ours / "1")
    with pytest.raises(ConfigError, match="two of its entries are of the same policies"):
        entries.pooled(ours)
    (write_seeds(tmp_path / "seven", [[1.0]]) / "0").rename(tmp_path / "seven" / "7")
    with pytest.raises(ConfigError, match="have no training seed in common"):
        entries.pairs(ours, tmp_path / "seven")


def test_a_benchmark_without_levels_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"comfort\.source=none: the benchmark's discomfort is that of a level"):
        suite.benchmark(asked("policy=random", "comfort=off", "levels=[]", f"output='{tmp_path / 'entry'}'"))
