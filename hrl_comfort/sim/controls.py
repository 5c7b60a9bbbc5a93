"""Control vectors of the compiled model: servo targets, limbs of the human, balls and points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrl_comfort import humans
from hrl_comfort.config import FAR_AWAY_M
from hrl_comfort.scene.human import LIMBS, limb_poses
from hrl_comfort.scene.workcell import Scene, ball_props

Array = NDArray[np.float64]


def limbs_of(scene: Scene, walk: humans.Walk) -> Array:
    """Return the limb poses (n, 5, 7) of n people."""
    phase, swing = humans.gait(walk)
    x, y = walk.position.T
    return limb_poses(x, y, walk.yaw, phase, swing, scene.floor_z)


def pack_controls(
    scene: Scene, targets: Array, limbs: Array, balls: Array, colours: NDArray[np.int64], points: Array
) -> Array:
    """Return control vectors (n, K * s, ncontrol): servo targets, mocap positions, mocap quaternions.

    targets (n, K * s, 6) rad, s to a control step; limbs (n * K, 5, 7) stay put over a control step; balls
    (n, B, 3) m, of colours (n, B), and points (n, P, 3) m over all of them. Balls are absent if there are points.
    """
    n, steps, places = len(targets), len(limbs) // len(targets), 6 + 3 * len(scene.mocap)
    control = np.empty((n, steps, targets.shape[1] // steps, scene.ncontrol))
    control[..., :6] = targets.reshape(*control.shape[:3], 6)
    position = control[..., 6:places].reshape(*control.shape[:3], -1, 3)
    quaternion = control[..., places:].reshape(*control.shape[:3], -1, 4)
    limbs = limbs.reshape(n, steps, 1, len(LIMBS), 7)
    position[..., : len(LIMBS), :], quaternion[..., : len(LIMBS), :] = limbs[..., :3], limbs[..., 3:]
    props = position[..., len(LIMBS) :, :]
    props[...], quaternion[..., len(LIMBS) :, :] = (FAR_AWAY_M, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
    if count := points.shape[1]:
        props[..., 2 : 2 + count, :] = points[:, None, None]
    else:
        for index in range(balls.shape[1]):
            prop = ball_props(index)[colours[:, index]]
            props[np.arange(n), :, :, prop] = balls[:, index, None, None]
    return control.reshape(n, -1, scene.ncontrol)
