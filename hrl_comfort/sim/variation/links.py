"""Links of another mass and joints with friction than the model's."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def vary_links(model: mujoco.MjModel, nominal: mujoco.MjModel, mass: Array, friction: Array) -> None:
    """Give the arm of `model`, a copy of `nominal`, other links.

    `mass` (J,) are the factors of the mass and inertia that each joint moves before the next one, `friction` (J,) the
    Coulomb friction of each joint over the largest torque of its servo.
    """
    for index in range(len(mass)):
        joint = int(nominal.actuator_trnid[index, 0])
        link, torque = int(nominal.jnt_bodyid[joint]), nominal.actuator_forcerange[index, 1]
        moved = [body for body in range(nominal.nbody) if nominal.body_weldid[body] == link]
        model.body_mass[moved] = nominal.body_mass[moved] * mass[index]
        model.body_inertia[moved] = nominal.body_inertia[moved] * mass[index]
        model.dof_frictionloss[nominal.jnt_dofadr[joint]] = torque * friction[index]
    mujoco.mj_setConst(model, mujoco.MjData(model))
