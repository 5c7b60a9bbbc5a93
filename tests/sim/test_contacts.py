"""Contacts are judged for each pair of capsules that begins to touch, in every physics step."""

from __future__ import annotations

from functools import cache

import numpy as np
import torch
from numpy.typing import NDArray

from hrl_comfort.composition.compose import compose
from hrl_comfort.files.run_config import environment
from hrl_comfort.safety.separation import TOUCH_M, Separation
from hrl_comfort.scene.human import limb_poses
from hrl_comfort.scene.workcell import Scene, build_scene
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.plan import Planned
from hrl_comfort.sim.sensors import Sensors
from hrl_comfort.tasks import State

Array = NDArray[np.float64]
SUBSTEPS = 4


@cache
def cell() -> tuple[Scene, Separation, State]:
    config = environment(compose("train", ["task=pick"]))
    engine = Engine(config, 1, 0)
    state = engine.reset()
    scene = build_scene(config.robot, config.cell, SUBSTEPS)
    return scene, Separation(scene), state


def readings(angles: list[Array], velocity: Array, touching: list[bool]) -> Array:
    """Return readings (1, 1, SUBSTEPS, nsensor) of an arm."""
    scene, *_ = cell()
    sensed = np.zeros((1, SUBSTEPS, scene.model.nsensordata))
    sensed[0, :, scene.sensors["joint_pos"]] = np.array(angles)
    sensed[0, :, scene.sensors["joint_vel"]] = velocity
    sensed[0, :, scene.sensors["human"].start] = touching
    return sensed[:, None]


def two_touches() -> tuple[Array, Array, Array, Array, float]:
    """Return angles with a touch, with a further one, and velocity (J,) there, limbs, and its speed, m/s."""
    scene, separation, _ = cell()
    rng = np.random.default_rng(0)
    while True:
        x, y, yaw = rng.uniform(-0.8, 0.8, 3)
        limbs = limb_poses(np.array([x]), np.array([y]), yaw, 0.0, 0.0, scene.floor_z)
        first = rng.uniform(-3, 3, 6)
        velocity = rng.uniform(-2, 2, 6)
        second = first + 0.05 * velocity
        before, after = (separation.touch(each[None], limbs)[0] for each in (first, second))
        _, speed = separation.pairs(second[None], velocity[None], limbs)
        new = after & ~before
        if before.any() and new.any() and (fastest := float(speed[..., 0][new].max())) > 0.3:
            return first, second, velocity, limbs, fastest


def test_a_second_pair_that_begins_to_touch_is_judged_while_another_one_touches() -> None:
    scene, separation, state = cell()
    first, second, velocity, limbs, fastest = two_touches()
    before = state.with_(touching=torch.ones(1, dtype=torch.bool), joint_pos=torch.from_numpy(first[None]))
    given = readings([first, first, second, second], velocity, [True] * 4)
    felt, planned = np.ones((1, 1, 4), dtype=bool), Planned({}, limbs[:, None])
    sensors = Sensors(scene, separation)
    assert sensors.approach(felt, given, planned.limbs, before, limbs) == np.array([fastest])
    still = readings([first] * 4, velocity, [True] * 4)
    assert sensors.approach(felt, still, planned.limbs, before, limbs) == -np.inf
    fields = sensors.read_decision(given, planned, before, limbs, None)
    assert fields["touching"].all() and fields["unsafe_contact"].all()
    assert not sensors.read_decision(still, planned, before, limbs, None)["unsafe_contact"].any()


def test_a_contact_shorter_than_a_control_step_counts() -> None:
    scene, separation, state = cell()
    _, second, velocity, limbs, _ = two_touches()
    away = limb_poses(np.array([50.0]), np.zeros(1), 0.0, 0.0, 0.0, scene.floor_z)
    apart, speed = separation.pairs(second[None], velocity[None], limbs)
    given = readings([scene.home, second, scene.home, scene.home], velocity, [False, True, False, False])
    fields = Sensors(scene, separation).read_decision(given, Planned({}, limbs[:, None]), state, away, None)
    assert fields["touching"].all() and fields["contact"].all()
    assert bool(fields["unsafe_contact"]) == bool((speed[apart <= TOUCH_M] > 0.25).any())
