"""The 2F-85's linkage: it opens to 85 mm, closes, keeps its pads parallel, and its links stay together."""

from __future__ import annotations

import mujoco
import numpy as np

from hrl_comfort.composition.compose import compose_environment
from hrl_comfort.scene.workcell import scene_of


def test_the_pads_stay_parallel_and_the_links_together_from_open_to_closed() -> None:
    scene = scene_of(compose_environment("train", ["cell=grasp", "human=none", "gripper=robotiq_2f85"]))
    model, data = scene.model, mujoco.MjData(scene.model)
    model.opt.gravity[:] = 0.0
    data.qpos[[model.joint(name).qposadr[0] for name in scene.joints]] = data.ctrl[:6] = scene.home
    gaps, steps = list[float](), round(1.0 / model.opt.timestep)
    for step in range(steps):
        data.ctrl[6] = 0.8 * min(1.0, 2 * step / steps)
        mujoco.mj_step(model, data)
        if step < 10:  # the spring brings the links to their stop
            continue
        pads = [data.geom(f"robot/{side}_pad") for side in ("left", "right")]
        axes = [pad.xmat.reshape(3, 3) for pad in pads]
        assert np.degrees(np.arccos(np.clip((np.trace(axes[0].T @ axes[1]) - 1) / 2, -1, 1))) < 5.0
        gaps.append(float(np.linalg.norm(pads[0].xpos - pads[1].xpos)) - 0.008)
        for side in ("left", "right"):
            coupler = data.geom(f"robot/{side}_coupler")
            end = coupler.xpos + coupler.xmat.reshape(3, 3)[:, 2] * model.geom(f"robot/{side}_coupler").size[1]
            other = coupler.xpos - coupler.xmat.reshape(3, 3)[:, 2] * model.geom(f"robot/{side}_coupler").size[1]
            follower = data.body(f"robot/{side}_follower").xpos
            assert min(np.linalg.norm(end - follower), np.linalg.norm(other - follower)) < 0.001
    assert 0.080 < gaps[0] < 0.087 and -0.004 < gaps[-1] < 0.0
    assert (np.diff(gaps) < 5e-4).all()
