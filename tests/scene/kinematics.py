"""Forward kinematics of the DH tables, which the compiled arms are held to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.scene.ur import UrModel


def forward_kinematics(model: UrModel, joint_pos: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the flange pose (..., 4, 4) in the base frame for joint angles (..., 6) in rad, calibration left out."""
    q = np.asarray(joint_pos, dtype=np.float64)
    pose = np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))
    for i, (a, d, alpha) in enumerate(zip(model.a_m, model.d_m, model.alpha_rad, strict=True)):
        c, s = np.cos(q[..., i]), np.sin(q[..., i])
        ca, sa = np.cos(alpha), np.sin(alpha)
        step = np.zeros((*q.shape[:-1], 4, 4))
        step[..., 0, 0], step[..., 0, 1], step[..., 0, 2] = c, -s * ca, s * sa
        step[..., 1, 0], step[..., 1, 1], step[..., 1, 2] = s, c * ca, -c * sa
        step[..., 2, 1], step[..., 2, 2] = sa, ca
        step[..., 0, 3], step[..., 1, 3], step[..., 2, 3] = a * c, a * s, d
        step[..., 3, 3] = 1.0
        pose = pose @ step
    return pose
