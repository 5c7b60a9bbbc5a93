"""Control vectors of the compiled model."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from hrl_comfort import humans
from hrl_comfort.config import FAR_AWAY_M
from hrl_comfort.scene.human import limb_poses
from hrl_comfort.scene.workcell import Scene

Array = NDArray[np.float64]


def limbs_of(scene: Scene, walk: humans.Walk) -> Array:
    """Return the limb poses (n, 7, 7) of n people, each in a cell of their own."""
    phase, swing = humans.gait(walk)
    x, y = walk.position.T
    return limb_poses(x, y, walk.yaw, phase, swing, scene.floor_z, walk.limbs)


def pack_controls(
    scene: Scene, targets: Array, limbs: Array, layout: Array, objects: Array, kinds: NDArray[np.int64], points: Array
) -> Array:
    """Return control vectors (n, K * s, ncontrol): servo targets, mocap positions, mocap quaternions.

    targets (n, K * s, J) rad, with a gripper that of its drive too, s to a control step; the drive's is 0 without it.
    Limbs (n * K, L, 7) stay put over a control step; the layout (n, F, 7) of places and obstacles, objects (n, B, 3) m,
    of kinds (n, B), and points (n, P, 3) m over all of them.
    Objects are absent if there are points; loose ones are not controlled.
    """
    n, steps, joints = len(targets), len(limbs) // len(targets), scene.model.nu
    places = joints + 3 * len(scene.mocap)
    control = np.empty((n, steps, targets.shape[1] // steps, scene.ncontrol))
    given = targets.shape[-1]
    control[..., :given], control[..., given:joints] = targets.reshape(*control.shape[:3], given), 0.0
    # Whole runs of numbers at once: numpy is slow on many short ones.
    position, quaternion = control[..., joints:places], control[..., places:]
    people, first = len(scene.limbs), scene.first_prop
    limbs, props = limbs.reshape(n, steps, 1, people, 7), len(scene.mocap) - first
    position[..., : 3 * people] = limbs[..., :3].reshape(n, steps, 1, -1)
    position[..., 3 * people : 3 * first] = layout[..., :3].reshape(n, 1, 1, -1)
    position[..., 3 * first :] = _absent(props)[0]
    quaternion[..., : 4 * people] = limbs[..., 3:].reshape(n, steps, 1, -1)
    quaternion[..., 4 * people : 4 * first] = layout[..., 3:].reshape(n, 1, 1, -1)
    quaternion[..., 4 * first :] = _absent(props)[1]
    props_at = position[..., 3 * first :].reshape(*control.shape[:3], props, 3)
    if count := points.shape[1]:
        props_at[..., :count, :] = points[:, None, None]
    elif not scene.loose:
        for index in range(objects.shape[1]):
            props_at[np.arange(n), :, :, scene.object_prop(index, kinds[:, index])] = objects[:, index, None, None]
    return control.reshape(n, -1, scene.ncontrol)


@cache
def _absent(props: int) -> tuple[Array, Array]:
    """Return position (3 * props,) m and quaternion (4 * props,) of props that are not there."""
    return np.tile((FAR_AWAY_M, 0.0, 0.0), props), np.tile((1.0, 0.0, 0.0, 0.0), props)
