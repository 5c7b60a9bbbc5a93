"""Rating, shield and contacts of a cell as graphs for the page, recorded from the functions that the engine runs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import EnvConfig
from hrl_comfort.humans import Walk
from hrl_comfort.safety.drive import SetPoints, make_drive
from hrl_comfort.safety.separation import UNSAFE_SPEED_M_S, Separation
from hrl_comfort.safety.shield import Memory
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.people import share_walked
from hrl_comfort.sim.signals import limbs_of
from hrl_comfort.studio.web.arrays import recorded

Array = NDArray[Any]


def safety(scene: Scene, env: EnvConfig, walk: Walk) -> dict[str, Any]:
    """Return the graphs of one cell; `walk` is an example of its person.

    `drive` (None in the paper's world) is a control step of `safety.drive.Drive`, `gap` the distance of arm and
    person, `walked` the share of a person's step that ends at the arm, `closing` the speed at which the arm nears the
    person.
    """
    separation = Separation(scene)
    drive, arm, person = make_drive(scene, separation, env, 1), separation.arm, separation.person
    shielded = drive is not None and drive.shield is not None

    def driven(
        joint_target: Array, target_vel: Array, asked: Array, limbs: Array, limbs_before: Array, trail: Array
    ) -> dict[str, Array]:
        assert drive is not None
        now = separation.encounter(joint_target, limbs)
        made: dict[str, Array] = {}
        if drive.shield is not None:
            drive.shield.memory = Memory(person.ends(limbs_before), trail)
            made["reach"] = drive.shield.reach(now, target_vel)
        after = drive.step(SetPoints.unshielded(joint_target, target_vel, np.zeros(1, np.int64)), asked, now)
        if drive.shield is not None:
            made["trail"] = drive.shield.memory.trail
        return made | {
            "joint_target": after.angles, "target_vel": after.velocity, "share": after.share, "braking": after.braking
        }  # fmt: skip

    def walked(joint_target: Array, limbs: Array, limbs_before: Array) -> dict[str, Array]:
        room, gap = (separation.gap(joint_target, each) for each in (limbs_before, limbs))
        return {"share": share_walked(room, gap)}

    angles, limbs = scene.home[None], limbs_of(scene, walk)
    still, rest = np.zeros_like(angles), np.zeros((len(arm.radius), 1))
    beside = {"joint_target": angles, "limbs": limbs}
    moving = {"joint_pos": angles, "joint_vel": still, "limbs": limbs}
    motion = {**beside, "target_vel": still, "asked": still, "limbs_before": limbs, "trail": rest}
    return {
        "drive": None if drive is None else recorded(driven, motion),
        "gap": recorded(lambda joint_target, limbs: {"gap": separation.gap(joint_target, limbs)}, beside),
        "walked": recorded(walked, {**beside, "limbs_before": limbs}),
        "closing": recorded(
            lambda joint_pos, joint_vel, limbs: {"speed": separation.closing_speed(joint_pos, joint_vel, limbs)}, moving
        ),
        "shielded": shielded,
        "stops": drive is not None or env.task.terminate_on == "unsafe_contact",
        "terminate_on": env.task.terminate_on,
        "unsafe_speed": UNSAFE_SPEED_M_S,
        "trail": rest[:, 0].tolist(),
    }
