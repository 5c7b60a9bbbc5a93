"""Postures free of contacts that bring the tool to a goal, by inverse kinematics (mink)."""

from __future__ import annotations

import mink
import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ITERATIONS, STEP_S = 40, 0.1
CLEARANCE_M = 0.02
"""Smallest distance between a posture and what stands in the cell."""
CHECK_RAD = np.radians(4.0)
"""Motion of the fastest joint between two checks of a straight way."""
PANS_RAD = np.radians(np.arange(-180.0, 180.0, 15.0))
"""Angles of the first joint at which the home posture must be free, where the arm turns raised."""
SPREAD_RAD = np.radians([15.0, 25.0, 30.0, 35.0, 30.0, 40.0])
"""Standard deviation of the initial posture of inverse kinematics, further joints as the last; policies leave the
wrist at any angle."""


class Postures:
    """Solver for an arm in the cell of `xml` (`Scene.xml`), without people, whose home posture is `home` (J,) rad.

    Postures keep `clearance_m` away from what stands there.
    """

    def __init__(self, xml: str, home: Array, clearance_m: float = CLEARANCE_M) -> None:
        self._model = mujoco.MjModel.from_xml_string(xml)
        self._model.geom_margin[self._model.geom_contype == 0] = clearance_m  # tables, pedestal, floor
        self._configuration, self._home = mink.Configuration(self._model), home
        self._data = self._configuration.data
        self._tool = mink.FrameTask("robot/tcp", "site", position_cost=1.0, orientation_cost=0.0, lm_damping=1e-3)
        self._limits = [mink.ConfigurationLimit(self._model)]
        self._spread = np.resize(SPREAD_RAD, len(home))
        self._spread[len(SPREAD_RAD) :] = SPREAD_RAD[-1]

    def stand(self, home: Array, layout: Array, first: int) -> None:
        """Go on with another home posture, and with the mocap bodies from `first` on at `layout` (F, 7)."""
        self._home, last = home, first + len(layout)
        self._data.mocap_pos[first:last], self._data.mocap_quat[first:last] = layout[:, :3], layout[:, 3:]

    def free(self, posture: Array) -> bool:
        """Return whether a posture (J,) rad keeps clear of everything and of itself."""
        self._data.qpos[:] = posture
        mujoco.mj_forward(self._model, self._data)
        return int(self._data.ncon) == 0

    def turns(self) -> bool:
        """Return whether the first joint can turn the home posture all round."""
        return all(self.free(np.array([pan, *self._home[1:]])) for pan in PANS_RAD)

    def rises(self, posture: Array) -> bool:
        """Return whether a straight way from a posture (J,) rad to home, turned as the posture is, is free."""
        way = np.array([posture[0], *self._home[1:]]) - posture
        checks = int(np.ceil(np.abs(way).max() / CHECK_RAD))
        return all(self.free(posture + way * share) for share in np.arange(1, checks + 1) / max(checks, 1))

    def solve(
        self,
        goal: Array,
        precision_m: float,
        count: int,
        tries: int,
        rng: np.random.Generator,
        rising: bool = False,
    ) -> Array:
        """Return up to `count` free postures (n, J) rad with the tool within `precision_m` of `goal` (3,) m.

        Each is solved from home, turned towards the goal, plus Gaussian noise, for a point near the surface of the
        sphere round the goal, where a policy stops. None of more than `tries` tries; if `rising`, those that `rises`.
        """
        configuration, found = self._configuration, list[Array]()
        mujoco.mj_kinematics(self._model, self._data)
        facing = self._data.body("robot/base").xmat[[3, 0]]
        towards = np.arctan2(goal[1], goal[0]) - np.arctan2(*facing)
        towards *= -1.0 if self._data.xaxis[0, 2] < 0 else 1.0
        for _ in range(tries):
            posture = self._home + rng.normal(size=len(self._home)) * self._spread
            # The arm may reach over the shoulder, as at home, or turned by half a circle.
            posture[0] += towards + rng.choice([-np.pi, 0.0, np.pi])
            posture[0] = (posture[0] + np.pi) % (2 * np.pi) - np.pi
            direction = rng.normal(size=3)
            point = goal + direction / np.linalg.norm(direction) * precision_m * rng.uniform(0.6, 0.98)
            configuration.update(posture)
            self._tool.set_target(mink.SE3.from_translation(point))
            for _ in range(ITERATIONS):
                velocity = mink.solve_ik(configuration, [self._tool], STEP_S, "daqp", damping=1e-3, limits=self._limits)
                configuration.integrate_inplace(velocity, STEP_S)
                if np.linalg.norm(self._data.site("robot/tcp").xpos - goal) < precision_m * 0.98:
                    break
            reached = np.linalg.norm(self._data.site("robot/tcp").xpos - goal) < precision_m
            posture = configuration.q.copy()
            if reached and self.free(posture) and (not rising or self.rises(posture)):
                found.append(posture)
                if len(found) == count:
                    break
        return np.array(found).reshape(-1, len(self._home))
