"""Goals, paces and people of scripted policies."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.comfort.terms import increment_threshold
from hrl_comfort.config import ComfortConfig, ConfigError, EnvConfig
from hrl_comfort.scene.human import limb_poses
from hrl_comfort.tasks import State, Subtask
from hrl_comfort.tasks.subtask import by_stage

Array = NDArray[np.float64]


def comfortable_pace(level: Tensor, comfort: ComfortConfig) -> Tensor:
    """Return the comfortable share (N,) of full speed at levels (N,); 1 where comfort does not weigh speed."""
    weighed = comfort.source != "none" and comfort.beta
    return increment_threshold(level, 1.0, comfort) if weighed else torch.ones_like(level)


def nearest_person(state: State) -> tuple[Array, Array]:
    """Return the axis (N, 2) m and the yaw (N,) rad of the person who is nearest to the tool."""
    places, yaw = state.humans_pos.numpy(), state.humans_yaw.numpy()
    apart = np.linalg.norm(places - state.tcp_pos.numpy()[:, None, :2], axis=-1)
    at = np.arange(len(places)), apart.argmin(axis=1)
    return places[at], yaw[at]


def standing_limbs(state: State, floor_z: float) -> Array:
    """Return the poses (N, L, 7) of the limbs of all people, as if they stood still where they are."""
    (x, y), yaw = np.moveaxis(state.humans_pos.numpy(), -1, 0), state.humans_yaw.numpy()
    return limb_poses(x, y, yaw, 0.0, 0.0, floor_z).reshape(len(yaw), -1, 7)


class StageGoals:
    """Goals of the stages in force, for a policy that acts on the joints.

    Raises:
      ConfigError: actions are not joint increments, or it has no command for a gripper.
    """

    def __init__(self, policy: str, config: EnvConfig, subtask: Subtask) -> None:
        if config.robot.gripper.holds and policy != "expert":
            raise ConfigError(
                f"robot.gripper.name={config.robot.gripper.name} is not allowed with policy={policy}; choose "
                "policy=expert, or gripper=none"
            )
        if config.task.action != "joint":
            raise ConfigError(
                f"task.action={config.task.action!r} is not allowed with policy={policy}; choose task.action=joint"
            )
        self._goal = by_stage(subtask.stages, lambda stage: stage.goal)
        self._homeward = torch.tensor([stage.joint_space for stage in subtask.stages])

    def __call__(self, state: State) -> tuple[Array, NDArray[np.bool_]]:
        """Return where the tool should go (N, 3) m, and whether (N,) the goal is the home posture instead."""
        index = state.stage.clamp(0, len(self._homeward) - 1)
        return self._goal(state.with_(stage=index)).numpy(), self._homeward[index].numpy()
