"""Models whose links, joints and objects differ from the scene's."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.variation.randomisation import Values

Array = NDArray[np.float64]


def vary(models: Sequence[mujoco.MjModel], scene: Scene, values: Values) -> None:
    """Give the bodies of `models`, n copies of that of `scene`, what `values` (n) say."""
    for model, mass, friction, factors in zip(models, values.mass, values.friction, values.objects, strict=True):
        if values.config.links:
            vary_links(model, scene.model, mass, friction)
        if values.config.objects:
            vary_objects(model, scene, factors)


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


def vary_objects(model: mujoco.MjModel, scene: Scene, factors: Array) -> None:
    """Give the objects of `model`, a copy of that of `scene`, other masses, friction and sizes.

    `factors` (3, kinds) are as of `object_factors`. A larger object is as heavy as before.
    """
    nominal, kinds = scene.model, factors.shape[1]
    for index, name in enumerate(scene.loose):
        mass, friction, size = factors[:, index % kinds]
        body, geom = nominal.body(name).id, nominal.geom(name).id
        boxes = slice(nominal.body_bvhadr[body], nominal.body_bvhadr[body] + nominal.body_bvhnum[body])
        model.body_mass[body] = nominal.body_mass[body] * mass
        model.body_inertia[body] = nominal.body_inertia[body] * mass * size**2
        model.geom_friction[geom, 0] = nominal.geom_friction[geom, 0] * friction
        for field in ("geom_size", "geom_aabb", "geom_rbound"):
            getattr(model, field)[geom] = getattr(nominal, field)[geom] * size
        model.bvh_aabb[boxes] = nominal.bvh_aabb[boxes] * size
    mujoco.mj_setConst(model, mujoco.MjData(model))
