"""Files of earlier versions: what was renamed is read under its new name."""

from __future__ import annotations

from pathlib import Path

import pytest

from hrl_comfort.composition.compose import compose
from hrl_comfort.files.run_config import load_config
from hrl_comfort.files.tables import read_table
from hrl_comfort.files.versions import SIX_SLOTS, converted, renamed
from tests.cells import PAPER

REFERENCE = Path(__file__).parents[2] / "runs" / "reference"
CELL = {
    "ball_m": [-0.615, -0.07, 0.287], "orange_drop_m": [0.647, -0.055, 0.273], "pink_drop_m": [0.126, 0.453, 0.265],
    "ball_radius_m": 0.03, "table_half_width_m": 0.08, "base_height_m": 0.75,
}  # fmt: skip
TASK = {"colour": "pink", "balls": 1, "ball_slots_m": [[0.0, 0.0]], "ball_jitter_m": 0.01, "name": "pick"}


def test_a_cell_of_three_tables_is_the_papers() -> None:
    found = converted({"cell": CELL, "task": TASK, "train_seed": 1})
    assert found["task"] == {"object": "pink", "objects": 1, "object_jitter_m": 0.01, "name": "pick"}
    assert found["train_seed"] == 1
    assert {name: place["top_m"] for name, place in found["cell"]["places"].items()} == {
        name: place.top_m for name, place in PAPER.places.items()
    }
    assert found["cell"]["places"]["ball_table"]["slots_m"] == PAPER.places["ball_table"].slots_m == SIX_SLOTS
    assert CELL["ball_m"] == [-0.615, -0.07, 0.287] and "balls" in TASK


def test_the_slots_of_several_balls_are_those_of_their_table() -> None:
    slots = [[0.0, -0.05], [0.0, 0.05]]
    found = converted({"cell": CELL, "task": {**TASK, "balls": 2, "ball_slots_m": slots}})
    assert found["cell"]["places"]["ball_table"]["slots_m"] == slots


@pytest.mark.parametrize(
    ("cell", "task"),
    [
        ({**CELL, "ball_m": "x"}, TASK),
        ({**CELL, "ball_radius_m": None}, TASK),
        ({"ball_m": [0, 0, 0]}, TASK),
        (CELL, {**TASK, "ball_slots_m": [[0.1, 0.0]]}),
        (None, None),
        (3, []),
    ],
)
def test_what_cannot_be_converted_stays_for_the_check_of_keys(cell: object, task: object) -> None:
    found = converted({"cell": cell, "task": task})
    assert found["cell"] == cell


def test_a_new_name_wins() -> None:
    assert renamed({"colour": 1, "object": 2, "other": 3}, {"colour": "object"}) == {"object": 2, "other": 3}


@pytest.mark.parametrize("run", ["pick", "comfort/stages/seed0", "shielded/seed2/place"])
def test_committed_runs_were_trained_in_the_papers_cell(run: str) -> None:
    assert load_config(REFERENCE / run).cell == PAPER
    assert compose("evaluate", [f"policy={REFERENCE / run}"]).cell == PAPER


def test_committed_episodes_have_the_kind_of_their_object() -> None:
    table = read_table(REFERENCE / "comfort" / "stages" / "seed0" / "eval" / "episodes.csv")
    assert table is not None and set(table["object"]) == {"orange", "pink"} and "objects_placed" in table
