"""Goals of scripted policies."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.tasks import State, Subtask
from hrl_comfort.tasks.subtask import by_stage


class StageGoals:
    """Goals of the stages in force, for a policy that acts on the joints.

    Raises:
      ConfigError: actions are not joint increments.
    """

    def __init__(self, policy: str, config: EnvConfig, subtask: Subtask) -> None:
        if config.task.action != "joint":
            raise ConfigError(
                f"task.action={config.task.action!r} is not allowed with policy={policy}; choose task.action=joint"
            )
        self._goal = by_stage(subtask.stages, lambda stage: stage.goal)
        self._homeward = torch.tensor([stage.joint_space for stage in subtask.stages])

    def __call__(self, state: State) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return where the tool should go (N, 3) m, and whether (N,) the goal is the home posture instead."""
        index = state.stage.clamp(0, len(self._homeward) - 1)
        return self._goal(state.with_(stage=index)).numpy(), self._homeward[index].numpy()
