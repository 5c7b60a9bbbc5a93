"""The table of evaluations in a terminal."""

from __future__ import annotations

from rich.console import Console

from hrl_comfort.analysis.tables import of_groups


def group(**labels):
    names = ("steps", "human_distance_mean_m", "contact", "unsafe_contact", "other_collision")
    metrics = {name: {"mean": 0.5, "ci95": [0.4, 0.6]} for name in names}
    metrics["success"] = {"mean": 0.985, "ci95": [0.9, 1.0]}
    return {"task": "pick_place", "policy": "runs/pick", "split": "validation", "episodes": 1000, **labels,
            "metrics": metrics}  # fmt: skip


def printed(groups):
    console = Console(width=80)
    with console.capture() as captured:
        console.print(of_groups(groups))
    return captured.get()


def test_labels_are_shown_where_groups_differ_the_level_and_the_split_always():
    out = printed([group(comfort_level=10, seen=seen) for seen in (True, False)])
    assert "level" in out and "split" in out and "task" not in out and "policy" not in out
    assert [line.split() for line in out.splitlines()[-2:]] == [
        ["validation", "10", spawns, "1000", *["98.5", "[90.0,", "100.0]", "0", "0.50", "50.0", "50.0", "50.0"]]
        for spawns in ("seen", "unseen")
    ]


def test_groups_of_several_tasks_fit_eighty_columns_with_every_success():
    without = group(comfort_level=None, seen=None)
    del without["split"], without["metrics"]["steps"]
    out = printed([group(task=task, comfort_level=1, seen=True) for task in ("pick_place", "reach")] + [without])
    assert max(len(line) for line in out.splitlines()) <= 80
    assert out.count("98.5 [90.0, 100.0]") == 3
