"""Arms from MJCF files, rebuilt from capsules like those of `scene.ur`.

The file is compiled by MuJoCo, and what an arm is made of is read from the compiled model: frames, axes, limits,
masses, inertias and shapes. Each colliding shape becomes a capsule, so that contacts, distances and the shield mean
the same for every arm, and contacts stay fast; of a link without one, each visual shape. Joints that are not named,
such as those of fingers, are fixed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import mujoco
import numpy as np
from dm_control import mjcf
from numpy.typing import NDArray

from hrl_comfort.config import ConfigError
from hrl_comfort.scene.servos import SERVO_LAG_S

Array = NDArray[np.float64]

FULL_TORQUE_RAD = np.radians(2.0)
"""Position error at which a servo gives its full torque, as for the UR arms."""
UNLIMITED_RAD = 2 * np.pi
"""Symmetric limit of joints without one."""
NEIGHBOURS = 2
"""Links so many joints apart do not collide: capsules are wider there than the housings."""
THICKNESS = 0.9
"""Share of a mesh's vertices within the radius of its capsule."""
SMALLEST_M = 1e-3
"""Smallest radius of a capsule."""
FARTHEST_M = 0.5
"""Farthest place of a first link that has no base."""
ENDLESS = [int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD)]
"""Shapes of floors."""


@dataclass(frozen=True)
class MjcfArm:
    """An arm of J hinges from an MJCF model; tuples are in joint order, base first."""

    name: str
    model: Callable[[], mujoco.MjModel]
    """Compiles the file; what stands in the world beside the arm, or carries its base, is left out."""
    joints: tuple[str, ...]
    """Names of the arm's hinges in the file."""
    tool: str
    """Site in the file at the tool centre point, z along the tool."""
    home_deg: tuple[float, ...]
    """Joint angles of the home pose, degrees."""
    torque_nm: tuple[float, ...]
    """Largest torques."""
    speed_deg_s: tuple[float, ...]
    """Rated speeds; `task.max_step_deg` should stay below 0.02 s of the slowest."""
    mount_deg: float = 0.0
    """Turn of the base about the vertical; limits of the first joint should leave no goal of the cell out."""

    def build(self) -> mjcf.RootElement:
        """Return the arm: bodies `base` and a `JOINT_link` a joint; joints and servos of their names; site `tcp`.

        A servo has its full torque at an error of 2 degrees, and at least critical damping for the inertia at home.
        Passive damping and friction of the file are left out: the servo stands for the drive.

        Raises:
          ConfigError: the file is not a serial arm with these joints and this site, or does not compile.
        """
        source = _Source(self)
        root = mjcf.RootElement(model="robot")
        root.compiler.angle = "radian"
        geom = root.default.geom
        geom.type, geom.contype, geom.conaffinity, geom.condim = "capsule", 1, 1, 1
        geom.rgba = (0.75, 0.78, 0.8, 1)
        turn = np.radians(self.mount_deg) / 2
        body = root.worldbody.add("body", name="base", quat=(np.cos(turn), 0, 0, np.sin(turn)))
        _add_capsules(body, "base", source.capsules(-1))
        for index, joint in enumerate(self.joints):
            position, turn = source.relative(index)
            body = body.add("body", name=f"{joint}_link", pos=position, quat=turn, gravcomp=1)
            body.add("joint", name=joint, range=source.limits(index), limited=True, **source.hinge(index))
            mass, centre, inertia = source.inertia(index)
            body.add("inertial", mass=mass, pos=centre, fullinertia=inertia)
            _add_capsules(body, f"{joint}_link", source.capsules(index))
        body.add("site", name="tcp", pos=source.tool[0], quat=source.tool[1], size=[0.005], group=4)
        self._exclude_overlaps(root)
        self._add_servos(root, source)
        return root

    def _exclude_overlaps(self, root: mjcf.RootElement) -> None:
        """Exclude contacts between near links, and between links that overlap at home."""
        bodies = ("base", *(f"{joint}_link" for joint in self.joints))
        pairs = {(a, b) for a, b in combinations(range(len(bodies)), 2) if b - a <= NEIGHBOURS}
        model, data = self._at_home(root)
        for contact in data.contact:
            names = sorted(bodies.index(model.body(model.geom_bodyid[geom]).name) for geom in contact.geom)
            pairs.add((names[0], names[1]))
        for a, b in sorted(pairs):
            root.contact.add("exclude", body1=bodies[a], body2=bodies[b])

    def _add_servos(self, root: mjcf.RootElement, source: _Source) -> None:
        model, data = self._at_home(root)
        full = np.empty((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        for index, joint in enumerate(self.joints):
            torque = self.torque_nm[index]
            stiffness = torque / FULL_TORQUE_RAD
            damping = max(SERVO_LAG_S * stiffness, 2 * np.sqrt(stiffness * full[index, index]))
            root.actuator.add(
                "position", name=joint, joint=joint, kp=stiffness, kv=damping, ctrlrange=source.limits(index),
                forcerange=(-torque, torque),
            )  # fmt: skip

    def _at_home(self, root: mjcf.RootElement) -> tuple[mujoco.MjModel, mujoco.MjData]:
        model = mujoco.MjModel.from_xml_string(root.to_xml_string())
        data = mujoco.MjData(model)
        data.qpos[:] = np.radians(self.home_deg)
        mujoco.mj_forward(model, data)
        return model, data


class _Source:
    """The compiled file with the arm's joints at 0; link -1 is the base, the body that carries the first link.

    The base's frame has the directions of the file's.
    """

    def __init__(self, arm: MjcfArm) -> None:
        self._arm, self._said = arm, f"robot.name={arm.name!r}"
        model = self._model = self._compiled()
        for name in arm.joints:
            if "/" in name:
                raise ConfigError(
                    f"{self._said}: joint {name!r} has a slash, which dm_control keeps; rename it in the file"
                )
        self._joints = [self._find(mujoco.mjtObj.mjOBJ_JOINT, name) for name in arm.joints]
        for length in (arm.home_deg, arm.torque_nm, arm.speed_deg_s):
            if len(length) != len(arm.joints):
                raise ConfigError(f"{self._said}: {length} must have a number for each of {arm.joints}")
        for joint, name in zip(self._joints, arm.joints, strict=True):
            if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
                raise ConfigError(f"{self._said}: joint {name!r} is not a hinge")
        self._links = [int(model.jnt_bodyid[joint]) for joint in self._joints]
        self._base = int(model.body_parentid[self._links[0]])
        self._data = mujoco.MjData(model)
        self._data.qpos[model.jnt_qposadr[self._joints]] = 0.0
        mujoco.mj_kinematics(model, self._data)
        mujoco.mj_comPos(model, self._data)
        self._owner = [self._owner_of(body) for body in range(model.nbody)]
        away = float(np.linalg.norm(self._data.xpos[self._links[0]]))
        if self._base == 0 and away > FARTHEST_M:
            raise ConfigError(
                f"{self._said}: joint {arm.joints[0]!r} is {away:.3g} m from the file's origin; "
                "put its link into a body for the base"
            )
        for index, link in enumerate(self._links):
            before = self._owner[model.body_parentid[link]]
            if before != index - 1 and not (index == 0 and before is None):
                raise ConfigError(f"{self._said}: joint {arm.joints[index]!r} does not follow the one before")
        site = self._find(mujoco.mjtObj.mjOBJ_SITE, arm.tool)
        if self._owner[model.site_bodyid[site]] != len(self._links) - 1:
            raise ConfigError(f"{self._said}: site {arm.tool!r} is not on the last link")
        turn, origin = self._frame(len(self._links) - 1)
        found = self._data.site(site)
        self.tool = (found.xpos - origin) @ turn, _quaternion(turn.T @ found.xmat.reshape(3, 3))
        """Position and quaternion of the tool in the frame of the last link."""

    def _compiled(self) -> mujoco.MjModel:
        try:
            return self._arm.model()
        except ConfigError:
            raise
        except (ValueError, OSError, mujoco.FatalError) as error:
            raise ConfigError(f"{self._said}: its file does not compile: {' '.join(str(error).split())}") from error

    def _find(self, kind: mujoco.mjtObj, name: str) -> int:
        found = mujoco.mj_name2id(self._model, kind, name)
        if found < 0:
            count = self._model.njnt if kind == mujoco.mjtObj.mjOBJ_JOINT else self._model.nsite
            names = ", ".join(str(mujoco.mj_id2name(self._model, kind, index)) for index in range(count))
            what = "joint" if kind == mujoco.mjtObj.mjOBJ_JOINT else "site"
            raise ConfigError(f"{self._said}: no {what} {name!r} in the file; it has {names}")
        return found

    def _owner_of(self, body: int) -> int | None:
        """Return the link that `body` is fixed to, -1 for the base, None for what is not of the arm."""
        while body and body != self._base and body not in self._links:
            body = int(self._model.body_parentid[body])
        if body in self._links:
            return self._links.index(body)
        return -1 if body and body == self._base else None

    def _frame(self, index: int) -> tuple[Array, Array]:
        """Return rotation (3, 3) and origin (3,) m of a link."""
        if index < 0:
            return np.eye(3), self._data.xpos[self._base]
        return self._data.xmat[self._links[index]].reshape(3, 3), self._data.xpos[self._links[index]]

    def relative(self, index: int) -> tuple[Array, Array]:
        """Return position (3,) m and quaternion (4,) of a link in the frame of the one before."""
        (turn, origin), (here, at) = self._frame(index - 1), self._frame(index)
        return (at - origin) @ turn, _quaternion(turn.T @ here)

    def hinge(self, index: int) -> dict[str, Any]:
        """Return axis (3,) and anchor (3,) m of a joint in the frame of its link; inertia of the drive, kg m²."""
        model, joint = self._model, self._joints[index]
        armature = float(model.dof_armature[model.jnt_dofadr[joint]])
        return {"axis": model.jnt_axis[joint].copy(), "pos": model.jnt_pos[joint].copy(), "armature": armature}

    def limits(self, index: int) -> tuple[float, float]:
        """Return the lowest and highest angle, rad."""
        if not self._model.jnt_limited[self._joints[index]]:
            return -UNLIMITED_RAD, UNLIMITED_RAD
        low, high = self._model.jnt_range[self._joints[index]]
        return float(low), float(high)

    def inertia(self, index: int) -> tuple[float, Array, tuple[float, ...]]:
        """Return mass (kg), centre (3,) m and inertia (xx, yy, zz, xy, xz, yz) kg m² of all that moves with a link."""
        model, data, (turn, origin) = self._model, self._data, self._frame(index)
        bodies = [body for body in range(model.nbody) if self._owner[body] == index]
        mass, at = model.body_mass[bodies], data.xipos[bodies]
        centre = mass @ at / mass.sum()
        total = np.zeros((3, 3))
        for body, part, place in zip(bodies, mass, at, strict=True):
            axes, away = data.ximat[body].reshape(3, 3), place - centre
            total += axes @ np.diag(model.body_inertia[body]) @ axes.T
            total += part * (away @ away * np.eye(3) - np.outer(away, away))
        local = turn.T @ total @ turn
        entries = (local[0, 0], local[1, 1], local[2, 2], local[0, 1], local[0, 2], local[1, 2])
        return float(mass.sum()), (centre - origin) @ turn, entries

    def capsules(self, index: int) -> list[tuple[Array, Array, float]]:
        """Return start (3,), end (3,) and radius, m, of the capsules of a link's colliding shapes, or else of all.

        Raises:
          ConfigError: a link that moves has none, and would pass through people.
        """
        model, (turn, origin) = self._model, self._frame(index)
        shapes = [
            geom for geom in range(model.ngeom)
            if self._owner[model.geom_bodyid[geom]] == index and model.geom_type[geom] not in ENDLESS
        ]  # fmt: skip
        if not shapes and index >= 0:
            joint = self._arm.joints[index]
            raise ConfigError(f"{self._said}: the link of joint {joint!r} has no shape; people would pass through it")
        found = []
        for geom in [g for g in shapes if model.geom_contype[g] or model.geom_conaffinity[g]] or shapes:
            start, end, radius = _capsule(model, geom)
            at, axes = self._data.geom_xpos[geom], self._data.geom_xmat[geom].reshape(3, 3)
            ends = [(at + axes @ point - origin) @ turn for point in (start, end)]
            found.append((ends[0], ends[1], radius))
        return found


def _capsule(model: mujoco.MjModel, geom: int) -> tuple[Array, Array, float]:
    """Return start (3,), end (3,) and radius, m, of the capsule that stands for a geom, in the geom's frame."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    up = np.array([0.0, 0.0, 1.0])
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return -0.0 * up, 0.0 * up, float(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return -size[1] * up, size[1] * up, float(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        half = max(size[1] - size[0], 0.0)
        return -half * up, half * up, float(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        return _enclosing(model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(np.float64))
    # A box, or the box around an ellipsoid.
    return _enclosing(size * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T)


def _enclosing(points: Array) -> tuple[Array, Array, float]:
    """Return start (3,), end (3,) and radius, m, of a capsule along the longest extent of points (P, 3) m."""
    middle = points.mean(axis=0)
    axis = np.linalg.svd(points - middle, full_matrices=False)[2][0]
    along = (points - middle) @ axis
    across = points - middle - along[:, None] * axis
    shift = (across.max(axis=0) + across.min(axis=0)) / 2
    shift -= shift @ axis * axis
    radius = max(float(np.quantile(np.linalg.norm(across - shift, axis=1), THICKNESS)), SMALLEST_M)
    low, high = along.min() + radius, along.max() - radius
    if low > high:
        low = high = (low + high) / 2
    return middle + shift + low * axis, middle + shift + high * axis, radius


def _add_capsules(body: mjcf.Element, name: str, capsules: list[tuple[Array, Array, float]]) -> None:
    for number, (start, end, radius) in enumerate(capsules):
        if np.linalg.norm(end - start) > SMALLEST_M:
            body.add("geom", name=f"{name}_{number}", fromto=(*start, *end), size=[radius])
        else:
            body.add("geom", name=f"{name}_{number}", type="sphere", pos=(start + end) / 2, size=[radius])


def _quaternion(turn: Array) -> Array:
    """Return the unit quaternion (4,), w first, of a rotation (3, 3)."""
    found = np.empty(4)
    mujoco.mju_mat2Quat(found, np.ascontiguousarray(turn).reshape(-1))
    return found
