"""The hand of a cell for the page: the command of its fingers as a graph, and limits by which objects are judged."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import EnvConfig
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.hand.fingers import Fingers
from hrl_comfort.sim.hand.sensors import FARTHEST_M, FASTEST_M_S, fallen_m
from hrl_comfort.studio.web.arrays import recorded
from hrl_comfort.tasks import State
from hrl_comfort.tasks.hand import CARRIED_M, FREE_STEPS, LIFT_M

Array = NDArray[Any]


def hand(scene: Scene, env: EnvConfig) -> dict[str, Any] | None:
    """Return what `src/hand.js` takes of a cell; None without a gripper.

    `fingers` is a control step of `sim.hand.fingers.Fingers`: set-point and command to the next set-point and the
    controls of the drive, one a physics step.
    """
    if scene.gripper is None:
        return None
    fingers = Fingers(scene)

    def followed(grip_target: Array, command: Array) -> dict[str, Array]:
        after = fingers.follow(grip_target, command)
        return {"grip_target": after, "control": fingers.ramp(grip_target, after, env.substeps)}

    first, last = scene.model.actuator_ctrlrange[len(scene.joints)].tolist()
    return {
        "fingers": recorded(followed, {"grip_target": np.zeros(1), "command": np.zeros(1)}),
        "open": first,
        "closed": last,
        "sizes": [each.half_m for each in env.cell.objects.values()],
        "carried": CARRIED_M,
        "lift": LIFT_M,
        "free": FREE_STEPS,
        "fallen": np.maximum(scene.floor_z + fallen_m(env.cell), -FARTHEST_M).tolist(),  # JSON has no infinity
        "farthest": FARTHEST_M,
        "fastest": FASTEST_M_S,
    }


def begun(state: State) -> dict[str, Any]:
    """Return what is known of the hand and of its object as an episode begins; nothing without a gripper."""
    if "grip_target" not in state.fields():
        return {}
    return {
        "grip_target": float(state.grip_target), "ground": float(state.ground), "carried": bool(state.carried),
    }  # fmt: skip
