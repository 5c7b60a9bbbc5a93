"""Configurations that another version of the program wrote, in config.yaml and in policy.pt, as this one has them.

Files are never rewritten: what differs is settled in reading. A key that has come since takes its value in BEFORE, or
else its default in conf/ for the task, the robot and the people of the file. So a new key whose default changes what
older runs do needs an entry in BEFORE. A key that is gone is refused, unless it had its value in GONE, which did
nothing. Keys that were renamed, or put in another form, are `converted` first.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, get_type_hints

from hrl_comfort.config.checks import UnknownKeyError

BEFORE: dict[str, Any] = {}
"""Value, by dotted key, that does what was done before the key came; where it is the default of conf/, none."""
GONE: dict[str, Any] = {"reward.human_collision": 0.0, "human.masked": False}
"""Value, by dotted key, with which a key that is gone did nothing."""
TASK = {"colour": "object", "balls": "objects", "ball_jitter_m": "object_jitter_m"}
"""Keys of the section `task` that were renamed."""
RULES = {"scripted": "nearest"}
"""Values of `meta_controller.name` that were renamed."""
LEARNERS = {"agent": "sac", "meta_controller_agent": "dqn"}
"""Learners, by section, when they had no names."""
CONTROLLER = {"balls": "objects"}
"""Keys that were renamed in the `spec` of a controller's file."""
CONTROLLER_BEFORE = {"interruption_steps": None}
"""Value, by key of that `spec`, before the key came."""
EXECUTOR = {"_first": "stage"}
"""Parts of a controller's training in progress: the first stage of an option stands for the one at which it started."""
COLUMNS = {
    "colour": "object", "balls_placed": "objects_placed", "balls_lost": "objects_lost",
    "balls_per_min": "objects_per_min",
}  # fmt: skip
"""Columns of episodes.csv that were renamed, and measures of a benchmark's entry."""
ONE_PERSON = {
    "human_pos": "humans_pos", "human_yaw": "humans_yaw", "human_seen": "humans_seen", "human_shown": "humans_shown",
}  # fmt: skip
"""Inputs of policies exported when a cell had one person, without an axis of people."""
INPUTS = {"ball_pos": "target_object", "drop_pos": "target_place", "colour": "target_kind", **ONE_PERSON}
"""Inputs of exported policies that were renamed."""
BALL_TABLES = {"ball_table": "ball_m", "orange_table": "orange_drop_m", "pink_table": "pink_drop_m"}
"""Places of a cell with the goals of its tables in keys of their own, which were the centres of balls on them."""
RGB = {"orange": [1.0, 0.5, 0.1], "pink": [1.0, 0.4, 0.7]}
ONE_SLOT = [[0.0, 0.0]]
SIX_SLOTS = [[x, y] for x in (-0.035, 0.035) for y in (-0.07, 0.0, 0.07)]
"""Of `task=sort`, when a task had the slots."""


def renamed(values: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """Return `values` with the keys that `names` gives them; a key that has its name already wins."""
    kept = {key: value for key, value in values.items() if names.get(key) not in values}
    return {names.get(key, key): value for key, value in kept.items()}


def converted(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the `values` of a configuration with its sections as this version has them.

    A cell had a ball table and two drop tables, a task the slots of the balls, and people had stations, if any.
    Sections that are damaged, or that this version cannot have, stay as they are: the check of keys refuses them.
    """
    found, cell, task = dict(values), values.get("cell"), values.get("task")
    if isinstance(task, Mapping):
        found["task"] = task = renamed(task, TASK)
    if isinstance(cell, Mapping) and (made := _with_places(cell, task)) is not None:
        found["cell"] = made
        if isinstance(task, dict):
            task.pop("ball_slots_m", None)
    for agent, name in LEARNERS.items():
        if isinstance(values.get(agent), Mapping):
            found[agent] = {"name": name, "own": {}, **values[agent]}
    human = values.get("human")
    if isinstance(human, Mapping) and human.get("stations_m") == []:  # of motions that have none
        found["human"] = {**human, "stations_m": None}
    top = values.get("meta_controller")
    if isinstance(top, Mapping) and top.get("name") in RULES:
        found["meta_controller"] = {**top, "name": RULES[top["name"]]}
    robot = values.get("robot")
    hand = robot.get("gripper") if isinstance(robot, Mapping) else None
    if values.get("disturbance") == "drop" and isinstance(hand, Mapping) and hand.get("name") not in (None, "none"):
        found["disturbance"] = "none"  # it was the default, and is for objects that ride on the tool
    hierarchy = values.get("hierarchy")
    if isinstance(hierarchy, Mapping) and isinstance(hierarchy.get("controller"), Mapping):
        found["hierarchy"] = {**hierarchy, "controller": converted(hierarchy["controller"])}
    return found


def _with_places(cell: Mapping[str, Any], task: object) -> dict[str, Any] | None:
    """Return a cell with tables in keys of their own as one with places and objects; None of any other."""
    slots = task.get("ball_slots_m", ONE_SLOT) if isinstance(task, Mapping) else ONE_SLOT
    alone = isinstance(task, Mapping) and task.get("objects", 1) == 1
    if alone and slots != ONE_SLOT:
        return None  # one ball lay in one of several slots
    try:
        radius, side = float(cell["ball_radius_m"]), 2 * float(cell["table_half_width_m"])
        points = {name: [float(value) for value in cell[key]] for name, key in BALL_TABLES.items()}
        tops = {name: [x, y, round(z - radius, 12)] for name, (x, y, z) in points.items()}
        height = cell["base_height_m"]
    except (KeyError, TypeError, ValueError):
        return None
    places: dict[str, Any] = {name: {"top_m": top, "size_m": [side, side]} for name, top in tops.items()}
    places["ball_table"]["slots_m"] = SIX_SLOTS if alone else slots
    ball = {"shape": "sphere", "size_m": [radius], "arrives_at": "ball_table"}
    objects = {name: {**ball, "belongs_at": f"{name}_table", "rgb": rgb} for name, rgb in RGB.items()}
    return {"places": places, "objects": objects, "obstacles": {}, "base_height_m": height}


def of_this_version(
    cls: type, values: Mapping[str, Any], defaults: Callable[[], Mapping[str, Any]], section: str = ""
) -> dict[str, Any]:
    """Return `values` with exactly the keys of the dataclass `cls`, in its sections too.

    Args:
      cls: the dataclass.
      values: what a file holds.
      defaults: returns the values of conf/ for `cls`; called if a key is missing.
      section: the dotted key of `values`.

    Raises:
      UnknownKeyError: there is a key that this version does not have.
    """
    before = f"{section}." if section else ""
    hints = get_type_hints(cls)
    for key in values.keys() - hints.keys():
        if f"{before}{key}" not in GONE or values[key] != GONE[f"{before}{key}"]:
            raise UnknownKeyError(
                f"{before}{key} is not a key of this version, which cannot do what it did; use the version whose "
                "commit is in provenance.json, or train again",
                f"{before}{key}",
            )
    found = {}
    for key, kind in hints.items():
        if key not in values:
            found[key] = BEFORE[f"{before}{key}"] if f"{before}{key}" in BEFORE else _default(cls, key, defaults())
        elif isinstance(kind, type) and dataclasses.is_dataclass(kind) and isinstance(values[key], Mapping):
            inside = lambda key=key: defaults()[key]  # noqa: E731
            found[key] = of_this_version(kind, values[key], inside, f"{before}{key}")
        else:
            found[key] = values[key]
    return found


def _default(cls: type, key: str, values: Mapping[str, Any]) -> Any:
    """Return the default of a key of `cls`: that of conf/, or else that of the dataclass."""
    if key in values:
        return values[key]
    own = next(each for each in dataclasses.fields(cls) if each.name == key)
    made = own.default if own.default_factory is dataclasses.MISSING else own.default_factory()
    return dataclasses.asdict(made) if dataclasses.is_dataclass(made) and not isinstance(made, type) else made
