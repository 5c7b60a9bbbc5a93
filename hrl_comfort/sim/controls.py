"""Control vectors of the compiled model."""

import numpy as np
from numpy.typing import NDArray

from hrl_comfort import humans
from hrl_comfort.compiled import contiguous
from hrl_comfort.config import FAR_AWAY_M
from hrl_comfort.scene import kernels
from hrl_comfort.scene.furniture import POINTS
from hrl_comfort.scene.human import walkers_limbs
from hrl_comfort.scene.workcell import Scene

Array = NDArray[np.float64]


def limbs_of(scene: Scene, walk: humans.Walk) -> Array:
    """Return the limb poses (n, 7, 7) of n people, each in a cell of their own."""
    return walkers_limbs(walk, scene.floor_z)


def pack_controls(
    scene: Scene, targets: Array, limbs: Array, layout: Array, objects: Array, kinds: NDArray[np.int64], points: Array
) -> Array:
    """Return control vectors (n, K * s, ncontrol): servo targets, mocap positions, mocap quaternions.

    targets (n, K * s, J) rad, with a gripper that of its drive too, s to a control step; the drive's is 0 without it.
    Limbs (n * K, L, 7) stay put over a control step; the layout (n, F, 7) of places and obstacles, objects (n, B, 3) m,
    of kinds (n, B), and points (n, P, 3) m over all of them.
    Objects are absent if there are points; loose ones are not controlled.
    """
    driven = targets.shape[-1]
    if driven < scene.model.nu:
        targets = np.concatenate([targets, np.zeros((*targets.shape[:2], scene.model.nu - driven))], axis=-1)
    bodies = 0 if scene.loose else len(scene.cell.objects)
    given = contiguous(targets, limbs, layout, objects, kinds, points)
    return kernels.controls(*given, len(POINTS), bodies, len(scene.mocap) - scene.first_prop, FAR_AWAY_M)
