"""Task-space actions: tool displacements to joint increments, by mink."""

from __future__ import annotations

import mink
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S, TaskConfig
from hrl_comfort.scene.workcell import Scene

Array = NDArray[np.float64]


TOOL_ACTION = 6
"""Size of a task-space action."""


def action_dim(scene: Scene, task: TaskConfig) -> int:
    """Return the size A of an action: a number for each joint, or TOOL_ACTION; with a gripper one more, the last."""
    arm = TOOL_ACTION if task.action == "cartesian" else len(scene.joints)
    return arm + (scene.gripper is not None)


class CartesianHand:
    """Differential inverse kinematics of one arm, applied row by row."""

    def __init__(self, scene: Scene, task: TaskConfig) -> None:
        self._configuration = mink.Configuration(scene.planning)
        self._tool = mink.FrameTask("robot/tcp", "site", position_cost=1.0, orientation_cost=0.2, lm_damping=1e-4)
        self._limits = [mink.ConfigurationLimit(scene.planning)]
        self._task = task

    def increments(self, joint_pos: Array, action: Array) -> Array:
        """Return joint increments (N, J) rad a control step, none above `max_step_deg`.

        action (N, 6) in [-1, 1]: tool translation and rotation, cell axes, in units of `max_step_m` and
        `max_step_rot_deg` a control step. An increment above the limit is scaled as a whole, so that the tool
        keeps its direction.
        """
        largest = np.radians(self._task.max_step_deg)
        found = np.empty_like(joint_pos)
        for row, (joints, move) in enumerate(zip(joint_pos, action, strict=True)):
            self._configuration.update(joints)
            now = self._configuration.get_transform_frame_to_world("robot/tcp", "site")
            turn = mink.SO3.exp(np.radians(self._task.max_step_rot_deg) * move[3:])
            place = now.translation() + self._task.max_step_m * move[:3]
            self._tool.set_target(mink.SE3.from_rotation_and_translation(turn @ now.rotation(), place))
            velocity = mink.solve_ik(
                self._configuration, [self._tool], CONTROL_STEP_S, "daqp", damping=1e-4, limits=self._limits
            )
            step = velocity * CONTROL_STEP_S
            found[row] = step * min(1.0, largest / max(np.abs(step).max(), 1e-12))
        return found
