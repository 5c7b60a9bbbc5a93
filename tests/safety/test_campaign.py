"""Beside every motion, behind the shield, no contact is fast and every set-point keeps to the rating."""

from __future__ import annotations

import pytest

from tests.safety.campaign import MOTIONS, run

OWN = "tests/humans/reach.bvh"


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("bound", ["worst", "observed"])
def test_beside_nobody_is_a_contact_fast_or_a_set_point_outside_the_rating(motion: str, bound: str) -> None:
    found = run(motion, "random", bound, steps=6000, seed=0, recordings=OWN, rows=16)
    assert found.steps >= 6000
    assert (found.unsafe_contacts, found.outside_rating) == (0, 0)


def test_somebody_who_leans_on_the_shoulder_does_not_fling_the_arm() -> None:
    found = run("adversary", "random", "observed", steps=7000, seed=1000, recordings=OWN, rows=64)
    assert found.contacts > 20 and found.fastest_m_s < 0.25


@pytest.mark.parametrize("policy", ["held", "press"])
def test_set_points_keep_to_the_rating_where_tables_hold_the_arm(policy: str) -> None:
    found = run("mixture", policy, "observed", steps=6000, seed=0, recordings=OWN, rows=16)
    assert (found.unsafe_contacts, found.outside_rating) == (0, 0)


@pytest.mark.parametrize(("disturbance", "policy"), [("block", "expert"), ("block", "held"), ("drop", "expert")])
def test_nor_is_one_where_an_object_is_lost_or_somebody_stands_in_the_way(disturbance: str, policy: str) -> None:
    found = run("mixture", policy, "observed", 6000, 0, OWN, rows=16, disturbance=disturbance)
    assert (found.unsafe_contacts, found.outside_rating) == (0, 0)
