"""Rating, shield and contacts of a cell as graphs for the page, recorded from the functions that the engine runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S, EnvConfig
from hrl_comfort.humans import Walk
from hrl_comfort.safety.drive import SetPoints, make_drive
from hrl_comfort.safety.rows import Rows
from hrl_comfort.safety.separation import TOUCH_M, UNSAFE_SPEED_M_S, Separation
from hrl_comfort.safety.shield import Memory
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.controls import limbs_of
from hrl_comfort.sim.people import share_walked
from hrl_comfort.sim.plan import arm_bodies, capsules
from hrl_comfort.sim.variation.layouts import tops
from hrl_comfort.studio.web.arrays import recorded

Array = NDArray[Any]


def safety(scene: Scene, env: EnvConfig, walk: Walk) -> dict[str, Any]:
    """Return the graphs of one cell; `walk` is an example of its person.

    `drive` (None in the paper's world) is a control step of `safety.drive.Drive`, `gap` the distance of arm and
    person, `walked` the share of a person's step that ends at the arm, `pairs` the distance of each pair of capsules
    and the speed at which the arm's closes it, `bodies` the fields of `Plan.bodies`.
    """
    separation = Separation(scene)
    drive, arm, person = make_drive(scene, separation, env, 1, every_row), separation.arm, separation.person
    shielded = drive is not None and drive.shield is not None
    places, obstacles = np.split(scene.layout, [len(env.cell.places)])
    standing = tops(env.cell, places, obstacles)[None]

    def driven(
        joint_target: Array, target_vel: Array, joint_pos: Array, joint_vel: Array, asked: Array, limbs: Array,
        limbs_before: Array, trail: Array,
    ) -> dict[str, Array]:  # fmt: skip
        assert drive is not None
        now = separation.encounter(joint_pos, limbs)
        made: dict[str, Array] = {}
        if drive.shield is not None:
            drive.shield.memory = Memory(person.ends(limbs_before), trail)
            made["reach"] = drive.shield.reach(now, target_vel)
        before = SetPoints.unshielded(joint_target, target_vel, np.zeros(1, np.int64))
        begin, after = drive.step(before, asked, np.concatenate([joint_pos, joint_vel], axis=1), now, tops=standing)
        if drive.shield is not None:
            made["trail"] = drive.shield.memory.trail
        return made | {
            "begin": begin, "joint_target": after.angles, "target_vel": after.velocity, "share": after.share,
            "braking": after.braking,
        }  # fmt: skip

    def walked(joint_pos: Array, limbs: Array, limbs_before: Array) -> dict[str, Array]:
        room, gap = (separation.gap(joint_pos, each) for each in (limbs_before, limbs))
        return {"share": share_walked(room, gap)}

    def pairs(joint_pos: Array, joint_vel: Array, limbs: Array) -> dict[str, Array]:
        apart, speed = separation.pairs(joint_pos, joint_vel, limbs)
        return {"apart": apart, "speed": speed}

    def bodies(joint_pos: Array, limbs: Array, limbs_before: Array, since: Array) -> dict[str, Array]:
        ends, before = person.ends(limbs), person.ends(limbs_before)
        return {
            **arm_bodies(arm, joint_pos, scene.hand_capsules),
            "humans_body": capsules(ends, person.radius),
            "humans_body_vel": capsules((ends - before) / since, np.empty(0)),
        }

    angles, limbs = scene.home[None], limbs_of(scene, walk)
    still, shield = np.zeros_like(angles), None if drive is None else drive.shield
    rest = np.zeros((len(arm.radius), 1, 1)) if shield is None else np.zeros_like(shield.memory.trail)
    beside = {"joint_pos": angles, "limbs": limbs}
    moving = {**beside, "joint_vel": still}
    motion = {
        **moving,
        "joint_target": angles,
        "target_vel": still,
        "asked": still,
        "limbs_before": limbs,
        "trail": rest,
    }
    return {
        "drive": None if drive is None else recorded(driven, motion),
        "gap": recorded(lambda joint_pos, limbs: {"gap": separation.gap(joint_pos, limbs)}, beside),
        "walked": recorded(walked, {**beside, "limbs_before": limbs}),
        "pairs": recorded(pairs, moving),
        "bodies": recorded(bodies, {**beside, "limbs_before": limbs, "since": np.ones(1)}),
        "shielded": shielded,
        "stops": drive is not None or env.task.terminate_on == "unsafe_contact",
        "terminate_on": env.task.terminate_on,
        "unsafe_speed": UNSAFE_SPEED_M_S,
        "touch": TOUCH_M,
        "trail": rest.ravel().tolist(),
        "first_step": env.safety.human_speed_m_s * CONTROL_STEP_S,
    }


def every_row(needed: Array, compute: Callable[[Rows], Array], otherwise: Array) -> Array:
    """Do what `safety.rows.InRows` says in a graph, which can leave no row out."""
    return np.where(needed.reshape(-1, *[1] * (otherwise.ndim - 1)), compute(slice(None)), otherwise)
