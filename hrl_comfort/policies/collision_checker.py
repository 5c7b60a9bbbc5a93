"""Geometry for the scripted expert: the arm as spheres, and contacts with the cell."""

from __future__ import annotations

import mink
import mujoco
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import FAR_AWAY_M
from hrl_comfort.safety.geometry import ArmGeometry
from hrl_comfort.scene.workcell import Scene

Array = NDArray[np.float64]

CHECK_RAD = np.radians(4.0)
"""Motion of the fastest joint between two checks for contact with the cell."""
SPACING_M = 0.06
"""Distance between the spheres that approximate a capsule of the arm."""
RISE_M = 0.08
"""Height by which the tool is raised where all ways are blocked."""
CLEARANCE_M = 0.01
"""Distance kept from the person and the arm itself."""
FURNITURE_CLEARANCE_M = 0.03
"""Distance kept from the cell: an arm that brakes late and is checked every CHECK_RAD strays by 1 to 2 cm."""


class ArmSpheres:
    """The arm as spheres along its capsules."""

    def __init__(self, scene: Scene) -> None:
        self.arm = ArmGeometry(scene)
        ends = self.arm.pose(scene.home[None]).ends[..., 0]
        counts = np.maximum(np.ceil(np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=0) / SPACING_M - 1e-9), 1) + 1
        self._part = np.repeat(np.arange(len(counts)), counts.astype(int))
        self._along = np.concatenate([np.linspace(0.0, 1.0, int(count)) for count in counts])
        self.radius = self.arm.radius[self._part]

    def spheres(self, joints: Array) -> Array:
        """Return the spheres' centres (..., P, 3) m."""
        ends = self.arm.pose(joints.reshape(-1, joints.shape[-1])).ends[:, self._part]
        centres = ends[:, :, 0] + (ends[:, :, 1] - ends[:, :, 0]) * self._along[:, None]
        return np.asarray(centres.T.reshape(*joints.shape[:-1], len(self.radius), 3))


class CollisionChecker:
    """Inverse kinematics and contact checks in the cell without a person."""

    def __init__(self, scene: Scene) -> None:
        self._model = mujoco.MjModel.from_xml_string(scene.planning_xml, dict(scene.assets))
        # The margins of two geoms add up.
        self._model.geom_margin[:] = CLEARANCE_M / 2
        self._model.geom_margin[self._model.geom_contype == 0] = FURNITURE_CLEARANCE_M - CLEARANCE_M / 2
        self._configuration = mink.Configuration(self._model)
        self._tool = mink.FrameTask("robot/tcp", "site", position_cost=1.0, orientation_cost=0.0, lm_damping=1e-4)
        self._limits = [mink.ConfigurationLimit(self._model)]
        self._data = self._configuration.data
        self._data.mocap_pos[: scene.first_furniture, 0] = FAR_AWAY_M
        self._furniture = slice(scene.first_furniture, scene.first_prop)

    def stand(self, layout: Array) -> None:
        """Put places and obstacles at their poses (F, 7) m and quaternion in another cell."""
        self._data.mocap_pos[self._furniture] = layout[:, :3]
        self._data.mocap_quat[self._furniture] = layout[:, 3:]

    def _slack(self, joints: Array) -> float:
        """Return by how much (m) the closest contact keeps more than its clearance, 0 if there is none nearer."""
        self._data.qpos[:] = joints
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)
        contact = self._data.contact
        return float((contact.dist - contact.includemargin).min(initial=0.0))

    def free(self, start: Array, end: Array) -> bool:
        """Return whether the straight leg keeps its clearance, or no less than it has at the start."""
        least = self._slack(start) - 1e-3
        length = np.abs(end - start).max()
        checks = np.concatenate(
            [np.radians(np.arange(1.0, 8.0)), np.arange(2 * CHECK_RAD, length, CHECK_RAD), [length]]
        )
        shares = checks[checks <= length] / max(length, 1e-9)
        return all(self._slack(start + share * (end - start)) >= least for share in shares)

    def raised(self, joints: Array) -> Array:
        """Return postures (5, J) near `joints` with the tool higher, and to one side in four of them."""
        self._configuration.update(joints)
        tool = self._data.site("robot/tcp").xpos.copy()
        found = []
        for aside in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)):
            self._configuration.update(joints)
            self._tool.set_target(mink.SE3.from_translation(tool + RISE_M * np.array([*aside, 1.0])))
            for _ in range(8):
                self._step()
            found.append(self._configuration.q.copy())
        return np.array(found)

    def escape(self, joints: Array) -> Array:
        """Return the posture farthest from contact among 60 nearby."""
        around = joints + np.radians(12.0) * np.random.default_rng(0).uniform(-1.0, 1.0, (60, len(joints)))
        return around[np.argmax([self._slack(posture) for posture in around])]

    def reach(self, seed: Array, goal: Array, tolerance: float) -> Array | None:
        """Return a collision-free posture near `seed` with the tool within `tolerance` of `goal`, if found."""
        self._configuration.update(seed)
        self._tool.set_target(mink.SE3.from_translation(goal))
        for _ in range(20):
            if np.linalg.norm(self._data.site("robot/tcp").xpos - goal) < tolerance:
                posture = self._configuration.q.copy()
                return posture if self._slack(posture) >= -1e-3 else None
            self._step()
        return None

    def _step(self) -> None:
        velocity = mink.solve_ik(self._configuration, [self._tool], 0.5, "daqp", damping=1e-4, limits=self._limits)
        self._configuration.integrate_inplace(velocity, 0.5)
