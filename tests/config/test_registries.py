"""The names that the configuration allows are those of the parts that implement them."""

from __future__ import annotations

import pytest

from hrl_comfort.comfort import sources, terms
from hrl_comfort.config import DISTURBANCES, FIGURES, SCRIPTED_POLICIES, ConfigError, comfort, hierarchy, task
from hrl_comfort.config.overrides import choices
from hrl_comfort.hierarchy.meta_controllers import make_choice
from hrl_comfort.hierarchy.observation import PERSON
from hrl_comfort.humans import MOTIONS
from hrl_comfort.plots import figure
from hrl_comfort.policies.load import SCRIPTED
from hrl_comfort.scene.robots import ROBOTS
from hrl_comfort.sim.disturbance import Disturbance
from hrl_comfort.tasks import SUBTASKS
from hrl_comfort.tasks.observations import LAYOUTS


@pytest.mark.parametrize(
    ("allowed", "registry"),
    [
        (comfort.SOURCES, sources.SOURCES),
        (comfort.FORMS, terms.FORMS),
        (comfort.THRESHOLDS, terms.THRESHOLDS),
        (comfort.SPEED_FORMS, terms.SPEED_FORMS),
        (SCRIPTED_POLICIES, SCRIPTED),
        (task.OBSERVATIONS, LAYOUTS),
        (hierarchy.META_OBSERVATIONS, PERSON),
        (FIGURES, [*figure.KINDS, "handover"]),
    ],
)
def test_the_configuration_allows_the_registered_names(allowed: tuple[str, ...], registry: object) -> None:
    assert allowed == tuple(registry)


def test_every_controller_of_the_configuration_exists() -> None:
    for name in hierarchy.CONTROLLERS:
        if name in ("none", "learned"):
            with pytest.raises(ConfigError, match=f"meta_controller={name} "):
                make_choice(name, 0)
        else:
            assert callable(make_choice(name, 0))


def test_a_part_that_is_named_by_a_file_of_its_group_exists() -> None:
    for group, registry in {"task": SUBTASKS, "human": {*MOTIONS, "mixture"}, "robot": ROBOTS}.items():
        assert set(choices(group)) == set(registry), group


def test_every_disturbance_of_the_configuration_exists() -> None:
    assert [Disturbance(kind, 1).kind for kind in DISTURBANCES] == list(DISTURBANCES)


def test_tasks_that_pick_and_place_have_both_stages() -> None:
    from hrl_comfort.config.commands import PICK_AND_PLACE

    stages = {name: {stage.name for stage in each.stages} for name, each in SUBTASKS.items()}
    both = {name for name, there in stages.items() if {"pick", "place"} <= there}
    assert both == set(PICK_AND_PLACE)
