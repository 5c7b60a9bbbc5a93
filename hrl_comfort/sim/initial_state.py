"""First states of episodes."""

from __future__ import annotations

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.config import EnvConfig
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.tasks import State

Array = NDArray[np.float64]


class InitialState:
    """State at the start of an episode: the first ball is the target, none is placed."""

    def __init__(self, scene: Scene, config: EnvConfig) -> None:
        self._precision, cell = config.task.precision, config.cell
        self._drops = np.array([cell.orange_drop_m, cell.pink_drop_m])
        data = mujoco.MjData(scene.model)
        data.qpos[:] = scene.home
        mujoco.mj_kinematics(scene.model, data)
        self._tcp_home, self._home = data.site("robot/tcp").xpos.copy(), scene.home

    def __call__(
        self,
        sensed: dict[str, Tensor],
        balls: Array,
        colours: NDArray[np.int64],
        points: Array,
        level: Array,
        precision_m: Array,
    ) -> State:
        """Return the states of n episodes.

        `sensed` are the fields that change within an episode; balls (n, B, 3) m, colours (n, B), points
        (n, 2, 3) m, level (n,), precision_m (n,): the grasp tolerance, to which the other tolerances scale.
        """
        n, precision = len(balls), self._precision
        scale = precision_m / precision.grasp_tolerance_m

        def constant(value: Array) -> Tensor:
            return torch.from_numpy(value).repeat(n, 1)

        return State(
            **sensed,
            tcp_home=constant(self._tcp_home),
            joint_home=constant(self._home),
            ball_pos=torch.from_numpy(balls[:, 0]),
            drop_pos=torch.from_numpy(self._drops[colours[:, 0]]),
            orange_drop=constant(self._drops[0]),
            pink_drop=constant(self._drops[1]),
            points=torch.from_numpy(points),
            colour=torch.from_numpy(colours[:, 0]),
            balls=torch.from_numpy(balls),
            colours=torch.from_numpy(colours),
            placed=torch.zeros(colours.shape, dtype=torch.bool),
            target=torch.zeros(n, dtype=torch.int64),
            level=torch.from_numpy(level.copy()),
            stage=torch.zeros(n, dtype=torch.int64),
            grasp_tolerance=torch.from_numpy(precision_m.copy()),
            place_tolerance=torch.from_numpy(scale * precision.place_tolerance_m),
            home_tolerance=torch.from_numpy(scale * np.radians(precision.home_tolerance_deg)),
        )
