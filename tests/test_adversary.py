"""Damaged artefacts and hostile command lines: one line or a result, in bounded time and memory, and nothing lost."""

from __future__ import annotations

import random
import re
import time
from pathlib import Path

import pytest

from tests.adversary import Adversary
from tests.artefacts import READ, make

EACH, COMMANDS = 2, 10


@pytest.fixture(scope="module")
def adversary(tmp_path_factory: pytest.TempPathFactory) -> Adversary:
    folder = tmp_path_factory.mktemp("artefacts")
    make(folder)
    return Adversary(folder)


@pytest.mark.parametrize("verb", READ)
def test_a_damaged_artefact_is_one_line_or_a_right_result(verb: str, adversary: Adversary) -> None:
    rng = random.Random(verb)
    for _ in range(EACH):
        what, faults = adversary.mutation(verb, rng)
        assert not faults, what


def test_a_hostile_command_line_is_one_line_and_touches_nothing_of_others(adversary: Adversary) -> None:
    rng = random.Random(0)
    for _ in range(COMMANDS):
        what, faults = adversary.command(rng)
        assert not faults, what


def test_a_case_is_held_to_its_time_on_a_processor_and_not_by_the_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def busy(_: list[str]) -> int:
        while True:
            pass

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tests.adversary.LIMIT_S", 1)
    found = []
    for case in (lambda _: time.sleep(3.2) or 0, busy):
        monkeypatch.setattr("tests.adversary.run", case)
        found.append(Adversary(tmp_path).faults([], re.compile("out")))
    assert not found[0] and "2 s of a processor" in found[1][1]
