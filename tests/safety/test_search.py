"""A short search over people and policies provokes unsafe contacts without the shield, and none behind it."""

from __future__ import annotations

import pytest

from tests.safety.search import ROWS, search


@pytest.mark.parametrize(
    ("bound", "task"), [("worst", "pick_place"), ("observed", "pick_place"), ("observed", "shift")]
)
def test_a_search_finds_no_unsafe_contact_behind_the_shield(bound: str, task: str) -> None:
    fastest, unsafe = search(6 * ROWS, "safety=ssm", f"safety.bound={bound}", f"task={task}")
    assert unsafe == 0 and fastest < 0.25


def test_without_it_the_same_search_does() -> None:
    fastest, unsafe = search(2 * ROWS, "safety=none")
    assert unsafe > 0 and fastest > 0.25
