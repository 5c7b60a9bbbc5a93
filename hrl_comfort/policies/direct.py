"""A scripted policy that minds nobody, for arms behind a shield: it lifts the tool, turns to the goal and lowers it.

It goes to one posture of each goal, the one nearest to home that is free of contact. Where the level asks for a pace
(`comfort.beta`), joints move no faster. It remembers nothing but postures.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from hrl_comfort.policies.expert import Expert
from hrl_comfort.policies.scripted import comfortable_pace
from hrl_comfort.tasks import State

TURNED_RAD = np.radians(25.0)
"""Remaining turn of the first joint below which the tool is lowered."""


class Direct(Expert):
    """Policy for any rows of any subtask; a function of the state.

    Raises:
      ConfigError: the robot is not one of UR_ARMS.
    """

    NAME = "direct"
    """By which `policy=` chooses it."""

    @torch.no_grad()
    def act(self, state: State) -> Tensor:
        """Return actions (N, 6) in [-1, 1]: joint increments in units of `max_step_deg` a control step."""
        joints, home = state.joint_target.numpy(), state.joint_home.numpy()
        target = home.copy()
        for row, goal in enumerate(self._goals_of(state)):
            if goal is not None:
                self._stand(state.layout[row].numpy(), home[row])
                target[row] = self._postures(goal)[0]
        turning = np.abs(target[:, 0] - joints[:, 0]) > TURNED_RAD
        target[turning, 1:] = home[turning, 1:]
        move = target - joints
        largest = np.abs(move).max(axis=-1, keepdims=True)
        pace = comfortable_pace(state.level, self._comfort).numpy()[:, None]
        return torch.from_numpy(move / np.maximum(largest / pace, self._slowing))
