"""Capsules of the arm and of the person: positions, distances and speeds, for N cells at once.

Everything is read from the compiled model, so that any serial arm of hinges is handled. Arrays have the batch last
and x, y, z first, because that is where numpy is fastest. They may be `numpy`'s own or others that obey its functions:
`hrl_comfort.studio.web.arrays` traces what is computed here, in `rating`, `separation`, `shield` and `drive`. What is
asked most often has a compiled twin in `kernels`, for numpy's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import contiguous, plain
from hrl_comfort.safety import kernels
from hrl_comfort.scene.workcell import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ArmPose:
    """The arm of N cells at some joint angles."""

    axis: Array
    """(3, J, N) unit vector of each joint axis, cell frame."""
    anchor: Array
    """(3, J, N) m, a point on each joint axis."""
    ends: Array
    """(3, C, 2, N) m, ends of the axis of each capsule."""


class ArmGeometry:
    """Kinematics of the C capsules of an arm of J joints; a sphere is a capsule of length 0."""

    def __init__(self, scene: Scene) -> None:
        model = scene.planning  # the fingers stand open, and a guard stands for what they hold
        joints = [int(model.actuator_trnid[i, 0]) for i in range(model.nu)]
        bodies = [int(model.jnt_bodyid[joint]) for joint in joints]
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        self.joints, self.bodies = len(joints), bodies
        turn, self._offset = _relative_poses(model, bodies)
        axis = model.jnt_axis[joints]
        cross = np.cross(np.eye(3), axis[:, None, :])  # (J, 3, 3), v -> axis x v
        turned = np.stack([turn, turn @ cross, turn @ cross @ cross])
        self._steps = turned.transpose(0, 2, 3, 1)[..., None]  # Rodrigues: I + sin q K + (1 - cos q) K²
        self._axis, self._anchor = axis, model.jnt_pos[joints].copy()
        found = [part for part in _capsules(model, data) if part[0] in bodies]
        self.link = np.array([bodies.index(part[0]) for part in found])
        """(C,) joint that moves each capsule."""
        self.local = np.stack([part[1] for part in found])
        """(C, 2, 3) m, ends of the axis of each capsule in the frame of its link."""
        self.radius = np.array([part[2] for part in found])
        """(C,) m."""
        steps = np.ascontiguousarray(self._steps[..., 0])
        self.compiled = steps, self._offset, self._axis, self._anchor, self.link, self.local
        """Its part that kernels take."""
        last = bodies[-1]
        self._tcp = (data.site("robot/tcp").xpos - data.xpos[last]) @ data.xmat[last].reshape(3, 3)
        self._tcp_axes = data.xmat[last].reshape(3, 3).T @ data.site("robot/tcp").xmat.reshape(3, 3)
        self.lever = self._levers()
        """(C, J) m, largest possible distance of a point of the capsule from a joint's anchor; 0 beyond it."""

    def tool(self, angles: Array) -> Array:
        """Return the tool centre point (N, 3) m at `angles` (N, J) rad."""
        rotation, _, origins = self._frames(angles)
        return (origins[:, -1] + _turned(rotation[:, :, -1], self._tcp[:, None])).T

    def tool_pose(self, angles: Array) -> tuple[Array, Array]:
        """Return position (N, 3) m and axes (N, 3, 3) of the tool at `angles` (N, J) rad."""
        rotation, _, origins = self._frames(angles)
        last = rotation[:, :, -1]
        axes = np.einsum("ijn,jk->nik", last, self._tcp_axes)
        return (origins[:, -1] + _turned(last, self._tcp[:, None])).T, axes

    def pose(self, angles: Array) -> ArmPose:
        """Return the arm at `angles` (N, J) rad."""
        if plain(angles):
            return ArmPose(*kernels.pose(*turns(angles), *self.compiled))
        rotation, anchor, origins = self._frames(angles)
        local = self.local.transpose(2, 0, 1)[..., None]
        ends = origins[:, self.link, None] + _turned(rotation[:, :, self.link, None], local)
        return ArmPose(_turned(rotation, self._axis.T[..., None]), anchor, ends)

    def _frames(self, angles: Array) -> tuple[Array, Array, Array]:
        """Return rotation (3, 3, J, N), a point on the axis and origin (3, J, N) m of the joints' links."""
        fixed, sine, cosine = self._steps
        steps = fixed + np.sin(angles.T) * sine + (1 - np.cos(angles.T)) * cosine  # (3, 3, J, N)
        n, turns, anchors, origins = len(angles), [], [], []
        turn, origin = np.broadcast_to(np.eye(3)[..., None], (3, 3, n)), np.zeros((3, n))
        for joint in range(self.joints):
            anchors.append(origin + _turned(turn, self._offset[joint]))
            turn = _turned(turn[:, :, None], steps[:, :, joint])
            origin = anchors[joint] - _turned(turn, self._anchor[joint])
            turns.append(turn)
            origins.append(origin)
        return np.stack(turns, axis=2), np.stack(anchors, axis=1), np.stack(origins, axis=1)

    def points(self, angles: Array, velocity: Array) -> tuple[Array, Array]:
        """Return ends and middles of the capsules (N, 3 C, 3) m and their velocities (N, 3 C, 3) m/s.

        `angles` (N, J) rad, `velocity` (N, J) rad/s.
        """
        pose = self.pose(angles)
        if plain(pose.ends, velocity):
            return kernels.points(*contiguous(pose.axis, pose.anchor, pose.ends, velocity), self.link)
        first, second = pose.ends[:, :, 0], pose.ends[:, :, 1]
        points = np.concatenate([first, (first + second) / 2, second], axis=1)
        turning = np.cumsum(pose.axis * velocity.T, axis=1)
        shift = np.cumsum(cross(pose.axis, pose.anchor) * velocity.T, axis=1)
        link = np.tile(self.link, 3)
        moving = cross(turning[:, link], points) - shift[:, link]
        return points.transpose(2, 1, 0), moving.transpose(2, 1, 0)

    def point_velocity(self, pose: ArmPose, velocity: Array, points: Array) -> Array:
        """Return the velocities (3, C, P, N) m/s of P points (3, C, P, N) m fixed to each capsule."""
        turning = np.cumsum(pose.axis * velocity.T, axis=1)[:, self.link, None]
        shift = np.cumsum(cross(pose.axis, pose.anchor) * velocity.T, axis=1)[:, self.link, None]
        return cross(turning, points) - shift

    def speeds(self, pose: ArmPose, velocity: Array) -> Array:
        """Return the speed (C, N) m/s of the fastest point of each capsule at joint velocities (N, J) rad/s."""
        if plain(velocity, pose.ends):
            moving = contiguous(pose.axis, pose.anchor, pose.ends, velocity)
            return kernels.speeds(*moving, self.link, self.radius)
        turning = np.cumsum(pose.axis * velocity.T, axis=1)
        shift = np.cumsum(cross(pose.axis, pose.anchor) * velocity.T, axis=1)
        spin = turning[:, self.link]
        at_ends = cross(spin[:, :, None], pose.ends) - shift[:, self.link, None]
        fastest: Array = norm(at_ends).max(axis=1) + self.radius[:, None] * norm(spin)
        return fastest

    def bending(self, velocity: Array) -> Array:
        """Return a bound (C, N) m/s² on the acceleration of any point at constant joint velocities (N, J) rad/s.

        A serial chain at constant joint rates accelerates a point by the sum over joints i <= j of
        u_i z_i x (u_j z_j x r_j), twice for i < j, where r_j reaches from joint j to the point.
        """
        if plain(velocity):
            swept = kernels.swept(*contiguous(velocity))
        else:
            rate = np.abs(velocity)
            swept = rate * (rate + 2 * (np.cumsum(rate, axis=1) - rate))
        bound: Array = self.lever @ swept.T
        return bound

    def _levers(self) -> Array:
        """Return (C, J) sums of link lengths from each joint's anchor to the farthest point of a capsule."""
        between = np.linalg.norm(self._offset - np.vstack([np.zeros(3), self._anchor[:-1]]), axis=1)
        levers = np.zeros((len(self.link), self.joints))
        for part, link in enumerate(self.link):
            tip = np.linalg.norm(self.local[part] - self._anchor[link], axis=1).max() + self.radius[part]
            for joint in range(link + 1):
                levers[part, joint] = tip + between[joint + 1 : link + 1].sum()
        return levers


class PersonGeometry:
    """The P capsules of people: their ends from the poses of their limbs, those of `names`, by default of everybody."""

    def __init__(self, scene: Scene, names: Sequence[str] | None = None) -> None:
        model, data = scene.model, mujoco.MjData(scene.model)
        mujoco.mj_kinematics(model, data)
        names = scene.limbs if names is None else names
        limbs = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, limb) for limb in names]
        found = [part for part in _capsules(model, data) if part[0] in limbs]
        self.limb = np.array([limbs.index(part[0]) for part in found])
        """(P,) limb of each capsule."""
        self._local = np.stack([part[1] for part in found])
        self.radius = np.array([part[2] for part in found])
        """(P,) m."""
        self.compiled = self.limb, self._local
        """Its part that kernels take."""

    def ends(self, limbs: Array) -> Array:
        """Return the ends (3, P, 2, N) m of the capsules' axes; limbs (N, L, 7): position m, quaternion w first."""
        if plain(limbs):
            return kernels.limb_ends(*contiguous(limbs), self.limb, self._local)
        moved = limbs.transpose(2, 1, 0)
        turns = rotations(moved[3:])[:, :, self.limb, None]
        return moved[:3, self.limb, None] + _turned(turns, self._local.transpose(2, 0, 1)[..., None])


def turns(angles: Array) -> tuple[Array, Array]:
    """Return the sines of `angles` (N, J) rad and 1 less their cosines, (J, N), as kernels take them."""
    turned = np.ascontiguousarray(angles.T)
    return np.sin(turned), 1 - np.cos(turned)


def gaps(arm: ArmGeometry, ends: Array, person: PersonGeometry, limbs: Array) -> Array:
    """Return the distance (C, N) m of each of the arm's capsules from the nearest person, negative in overlap.

    `ends` (3, C, 2, N) and `limbs` (3, P, 2, N) are the ends of the capsules of arm and people.
    """
    if plain(ends, limbs):
        return kernels.gaps(*contiguous(ends, limbs), arm.radius, person.radius)
    apart = segment_distance(ends[:, :, None, 0], ends[:, :, None, 1], limbs[:, None, :, 0], limbs[:, None, :, 1])
    nearest: Array = (apart - (arm.radius[:, None, None] + person.radius[:, None])).min(axis=1)
    return nearest


def farthest(ends: Array, before: Array) -> Array:
    """Return how far (N,) m the capsules' ends that moved most went from `before` to `ends` (3, P, 2, N) m."""
    if plain(ends, before):
        return kernels.farthest(*contiguous(ends, before))
    way: Array = norm(ends - before).max(axis=(0, 1))
    return way


def segment_distance(p: Array, p_end: Array, q: Array, q_end: Array) -> Array:
    """Return the distance (...,) between segments p to p_end and q to q_end (3, ...)."""
    on_p, on_q = closest_points(p, p_end, q, q_end)
    return norm(on_p - on_q)


def closest_points(p: Array, p_end: Array, q: Array, q_end: Array) -> tuple[Array, Array]:
    """Return the closest points (3, ...) of segments p to p_end and q to q_end (3, ...).

    Those of the lines, clamped to one segment and then to the other (Ericson, Real-Time Collision Detection, 2005,
    section 5.1.9).
    """
    d, e, r = p_end - p, q_end - q, p - q
    aa, ee = np.maximum(dot(d, d), 1e-12), np.maximum(dot(e, e), 1e-12)
    b, c, f = dot(d, e), dot(d, r), dot(e, r)
    denominator = aa * ee - b * b
    s = np.where(denominator > 1e-12, (b * f - c * ee) / np.maximum(denominator, 1e-12), 0.0)
    t = np.minimum(np.maximum((b * np.minimum(np.maximum(s, 0.0), 1.0) + f) / ee, 0.0), 1.0)
    s = np.minimum(np.maximum((b * t - c) / aa, 0.0), 1.0)
    return p + d * s, q + e * t


def norm(vectors: Array) -> Array:
    """Return the lengths (...,) of vectors (3, ...)."""
    length: Array = np.sqrt(dot(vectors, vectors))
    return length


def rotations(quaternions: Array) -> Array:
    """Return the rotation matrices (3, 3, ...) of unit quaternions (4, ...), w first."""
    w, x, y, z = quaternions
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
        ]
    )


def _turned(turn: Array, vector: Array) -> Array:
    """Return rotations (3, 3, ...) times vectors (3, ...)."""
    turned: Array = turn[:, 0] * vector[0] + turn[:, 1] * vector[1] + turn[:, 2] * vector[2]
    return turned


def dot(first: Array, second: Array) -> Array:
    """Return the products (...,) of vectors (3, ...) and (3, ...)."""
    product: Array = first[0] * second[0] + first[1] * second[1] + first[2] * second[2]
    return product


def cross(first: Array, second: Array) -> Array:
    """Return the cross products (3, ...) of vectors (3, ...)."""
    a, b, c = first
    x, y, z = second
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x])


def _relative_poses(model: mujoco.MjModel, bodies: list[int]) -> tuple[Array, Array]:
    """Return rotation (J, 3, 3) of each body in the one before it, and its joint's anchor (J, 3) m there."""
    turns, anchors = [], []
    for index, body in enumerate(bodies):
        turn, origin, at = np.eye(3), np.zeros(3), body
        until = bodies[index - 1] if index else 0
        while at != until:
            fixed = rotations(model.body_quat[at])
            turn, origin = fixed @ turn, model.body_pos[at] + fixed @ origin
            at = int(model.body_parentid[at])
        turns.append(turn)
        joint = int(model.body_jntadr[body])
        anchors.append(origin + turn @ model.jnt_pos[joint])
    return np.stack(turns), np.stack(anchors)


def _capsules(model: mujoco.MjModel, data: mujoco.MjData) -> list[tuple[int, Array, float]]:
    """Return body, axis ends (2, 3) in its frame and radius, m, of every capsule and sphere that a body carries.

    A body without joint that is not moved by mocap passes its capsules on to its parent.
    """
    found = []
    for geom in range(model.ngeom):
        sphere = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE
        if not sphere and model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_CAPSULE:
            continue
        body = int(model.geom_bodyid[geom])
        while body and not model.body_jntnum[body] and model.body_mocapid[body] < 0:
            body = int(model.body_parentid[body])
        size, half = model.geom_size[geom][:2]
        axis = (0.0 if sphere else half) * data.geom_xmat[geom].reshape(3, 3)[:, 2]
        ends = data.geom_xpos[geom] + np.array([-1.0, 1.0])[:, None] * axis
        found.append((body, (ends - data.xpos[body]) @ data.xmat[body].reshape(3, 3), float(size)))
    return found
