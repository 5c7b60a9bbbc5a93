"""Two coupled slides with box pads, as long, wide and heavy as a Robotiq 2F-85.

Policies learn with them in its place: without linkages the physics is faster.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from dm_control import mjcf

from hrl_comfort.scene.grippers.gripper import DRIVE

PALM_M, FINGER_M, TOOL_M = 0.055, 0.08, 0.152
"""Along z from the flange: end of the palm, origin of the fingers, tool centre point."""
SPREAD_M, STROKE_M = 0.0465, 0.0435
"""Distance of an open pad's middle from the tool, and way of a finger; closed pads overlap by 2 mm."""
PAD_M = (0.004, 0.011, 0.0213)
"""Half sides of a pad."""
PALM_KG, FINGER_KG, PAD_KG = 0.80, 0.03, 0.02
STIFF_M = 0.01
"""Position error at which the drive has its full force."""
_DARK, _RUBBER = (0.2, 0.2, 0.22, 1), (0.1, 0.1, 0.1, 1)


@dataclass(frozen=True)
class TwoFinger:
    """Two coupled slides with box pads, moved by one drive."""

    name: str = "two_finger"
    opening_m: float = 2 * (SPREAD_M - PAD_M[0])
    tip_m: float = math.hypot(*PAD_M[1:])
    pads: tuple[str, str] = ("left_finger", "right_finger")

    def attach(self, flange: mjcf.Element, force_n: float) -> None:
        """See `Gripper`."""
        palm, root = flange.add("body", name="gripper", gravcomp=1), flange.root
        radius, length = 0.036, 0.09
        across, along = PALM_KG * (3 * radius**2 + length**2) / 12, PALM_KG * radius**2 / 2
        palm.add("inertial", mass=PALM_KG, pos=(0, 0, length / 2), diaginertia=(across, across, along))
        palm.add("geom", name="hand", fromto=(0, 0, 0.02, 0, 0, PALM_M), size=[radius], rgba=_DARK)
        palm.add("site", name="tcp", pos=(0, 0, TOOL_M), size=[0.005], group=4)
        length = TOOL_M - FINGER_M
        for name, side in zip(self.pads, (1, -1), strict=True):
            finger = palm.add("body", name=name, pos=(side * SPREAD_M, 0, FINGER_M), gravcomp=1)
            finger.add(
                "joint", name=name, type="slide", axis=(-side, 0, 0), range=(0, STROKE_M), limited=True, armature=0.05,
                damping=5.0,
            )  # fmt: skip
            outside = side * 0.007
            finger.add(
                "geom", name=name, fromto=(outside, 0, 0, outside, 0, length), size=[0.007], mass=FINGER_KG, rgba=_DARK
            )
            finger.add(
                "geom", name=f"{name}_pad", type="box", pos=(0, 0, length), size=PAD_M, mass=PAD_KG, rgba=_RUBBER
            )
        left, right = self.pads
        step_s = 0.005
        root.equality.add("joint", joint1=left, joint2=right, polycoef=(0, 1, 0, 0, 0), solref=(2 * step_s, 1))
        tendon = root.tendon.add("fixed", name=DRIVE)
        for name in self.pads:
            tendon.add("joint", joint=name, coef=0.5)
        stiffness = force_n / STIFF_M
        root.actuator.add(
            "position", name=DRIVE, tendon=DRIVE, kp=stiffness, kv=0.05 * stiffness, ctrlrange=(0, STROKE_M),
            forcerange=(-force_n, force_n),
        )  # fmt: skip
        root.contact.add("exclude", body1=left, body2=right)
