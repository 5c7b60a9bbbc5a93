"""Goals and paces of scripted policies."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.comfort.terms import increment_threshold
from hrl_comfort.config import ComfortConfig, ConfigError, EnvConfig
from hrl_comfort.tasks import State, Subtask
from hrl_comfort.tasks.subtask import by_stage


def comfortable_pace(level: Tensor, comfort: ComfortConfig) -> Tensor:
    """Return the comfortable share (N,) of full speed at levels (N,); 1 where comfort does not weigh speed."""
    weighed = comfort.source != "none" and comfort.beta
    return increment_threshold(level, 1.0, comfort) if weighed else torch.ones_like(level)


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
