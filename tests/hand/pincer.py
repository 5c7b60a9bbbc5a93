"""A gripper of a user's own: longer jaws with other pads."""


class Pincer:
    name = "pincer"
    opening_m, tip_m = 0.11, 0.016  # between the open pads; from the tool to the farthest point of a pad
    pads = ("left_jaw", "right_jaw")

    def attach(self, flange, force_n):
        palm, root = flange.add("body", name="gripper", gravcomp=1), flange.root
        palm.add("inertial", mass=0.6, pos=(0, 0, 0.05), diaginertia=(8e-4, 8e-4, 3e-4))
        palm.add("geom", name="palm", fromto=(0, 0, 0.02, 0, 0, 0.08), size=[0.03])
        palm.add("site", name="tcp", pos=(0, 0, 0.17), size=[0.005], group=4)
        tendon = root.tendon.add("fixed", name="hand")
        for name, side in zip(self.pads, (1, -1), strict=True):
            jaw = palm.add("body", name=name, pos=(side * 0.06, 0, 0.09), gravcomp=1)
            slide = {"type": "slide", "axis": (-side, 0, 0), "range": (0, 0.058), "limited": True}
            jaw.add("joint", name=name, armature=0.05, damping=5, **slide)
            jaw.add("geom", name=name, type="box", pos=(0, 0, 0.08), size=(0.005, 0.01, 0.012), mass=0.03)
            stem = (side * 0.007, 0, 0, side * 0.007, 0, 0.075)
            jaw.add("geom", name=f"{name}_stem", fromto=stem, size=[0.007], mass=0.02)
            tendon.add("joint", joint=name, coef=0.5)
        root.equality.add("joint", joint1=self.pads[0], joint2=self.pads[1], polycoef=(0, 1, 0, 0, 0), solref=(0.01, 1))
        drive = {"ctrlrange": (0, 0.058), "forcerange": (-force_n, force_n)}
        root.actuator.add("position", name="hand", tendon="hand", kp=100 * force_n, kv=5 * force_n, **drive)
        root.contact.add("exclude", body1=self.pads[0], body2=self.pads[1])


PINCER = Pincer()
