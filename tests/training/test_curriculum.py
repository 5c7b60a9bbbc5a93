"""When the precision tightens, and when it must not."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hrl_comfort.composition.compose import compose
from hrl_comfort.training.curriculum import Curriculum

CONFIG = compose("train")
ADAPTIVE = replace(CONFIG.curriculum, kind="adaptive", start_m=0.3, end_m=0.1, step_m=0.04, threshold=0.9, window=10)


def adaptive() -> Curriculum:
    return Curriculum(ADAPTIVE, CONFIG.task.precision, 1000)


def feed(curriculum: Curriculum, successes: int, failures: int = 0) -> None:
    at = curriculum.precision_m
    curriculum.advance(0, [(at, False)] * failures + [(at, True)] * successes)


def test_off_stays_at_the_tasks_precision():
    curriculum = Curriculum(replace(ADAPTIVE, kind="off"), replace(CONFIG.task.precision, grasp_tolerance_m=0.17), 1000)
    curriculum.advance(999, [(0.17, True)] * 100)
    assert curriculum.precision_m == 0.17


def test_linear_ends_at_its_share_of_the_training_and_stays_there():
    curriculum = Curriculum(replace(ADAPTIVE, kind="linear", fraction=0.5), CONFIG.task.precision, 1000)
    seen = []
    for policy_steps in (0, 250, 500, 900):
        curriculum.advance(policy_steps, [])
        seen.append(curriculum.precision_m)
    assert seen == pytest.approx([0.3, 0.2, 0.1, 0.1])


def test_adaptive_tightens_at_the_threshold_and_not_below():
    curriculum = adaptive()
    feed(curriculum, failures=2, successes=8)
    assert curriculum.precision_m == 0.3
    feed(curriculum, successes=1)
    assert curriculum.precision_m == 0.26


def test_starts_widen_as_the_precision_tightens():
    assert adaptive().reach is None
    curriculum = Curriculum(replace(ADAPTIVE, reach=[0.2, 2.2]), CONFIG.task.precision, 1000)
    seen = [curriculum.reach]
    for _ in range(6):
        feed(curriculum, successes=10)
        seen.append(curriculum.reach)
    assert seen == pytest.approx([0.2, 0.6, 1.0, 1.4, 1.8, 2.2, 2.2])


def test_adaptive_waits_for_a_full_window():
    curriculum = adaptive()
    feed(curriculum, successes=9)
    assert curriculum.precision_m == 0.3


def test_adaptive_starts_a_new_window_after_tightening():
    curriculum = adaptive()
    feed(curriculum, successes=10)
    feed(curriculum, successes=9)
    assert curriculum.precision_m == 0.26
    feed(curriculum, successes=1)
    assert curriculum.precision_m == 0.22


def test_adaptive_ignores_episodes_begun_at_a_coarser_precision():
    curriculum = adaptive()
    feed(curriculum, successes=10)
    curriculum.advance(0, [(0.3, True)] * 50)
    assert curriculum.precision_m == 0.26


def test_adaptive_lands_on_the_end_and_stays():
    curriculum = Curriculum(replace(ADAPTIVE, step_m=0.07), CONFIG.task.precision, 1000)
    seen = [curriculum.precision_m]
    for _ in range(5):
        feed(curriculum, successes=10)
        seen.append(curriculum.precision_m)
    assert seen == [0.3, 0.23, 0.16, 0.1, 0.1, 0.1]


def test_a_loaded_curriculum_goes_on_in_the_middle_of_a_window():
    curriculum, other = adaptive(), adaptive()
    feed(curriculum, successes=10)
    feed(curriculum, successes=9)
    other.load_state_dict(curriculum.state_dict())
    feed(other, successes=1)
    assert other.precision_m == 0.22
