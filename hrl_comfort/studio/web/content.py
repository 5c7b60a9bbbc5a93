"""Content of a page: the model, the policies as graphs, episodes with their person, numbers of cell and task."""

from __future__ import annotations

import base64
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from hrl_comfort.comfort.adapt import max_episode_steps
from hrl_comfort.config import CONTROL_STEP_S, FAR_AWAY_M, SORTING, ConfigError, StudioConfig
from hrl_comfort.files.run_config import environment
from hrl_comfort.hierarchy.options import Option
from hrl_comfort.humans import body, walk
from hrl_comfort.humans.motions.live import ARRIVED_M
from hrl_comfort.policies.actor import load_policy
from hrl_comfort.policies.graph import PolicyGraph, inputs_of
from hrl_comfort.policies.load import observed_by
from hrl_comfort.scene import Scene, human
from hrl_comfort.scene.looks import dressed
from hrl_comfort.studio.clip import decision_clip
from hrl_comfort.studio.person import FARTHEST_M, fastest_m_s, motion_config
from hrl_comfort.studio.session import Session
from hrl_comfort.studio.view import body_meshes
from hrl_comfort.studio.web.hand import begun, hand
from hrl_comfort.studio.web.safety import safety
from hrl_comfort.studio.web.trace import StageGraph, constant, traced
from hrl_comfort.tasks import subtask

EPISODES = 8
"""Episodes after which the page begins again with the first."""
RECORDED_S = 20.0
"""Time that the person of an episode walks; then they stand."""
ENTRANCE_M = [-0.9, -0.9]
"""Place where a person who is taken over enters a cell without one."""
LOOK_UNIT_M = 1e-4
"""Unit of the vertices of the looks."""
FIELDS = {
    "joint_pos", "joint_vel", "joint_target", "tcp_pos", "tcp_home", "joint_home", "humans_pos", "humans_yaw",
    "humans_seen", "target_object", "target_place", "target_kind", "kind_places", "points", "stage", "level",
    "steps", "grasp_tolerance", "place_tolerance", "home_tolerance", "share", "tops", "arm_body", "hand_body",
    "humans_body", "humans_body_vel", "grip", "grip_vel", "grip_target", "tcp_quat", "target", "objects_quat",
    "objects_vel", "pads", "ground", "aloft_steps", "free_steps", "kind_sizes",
}  # fmt: skip
"""Fields of a State that the page has."""


def content(config: StudioConfig) -> dict[str, Any]:
    """Return the content of the page for `config`, ready for JSON.

    Raises:
      ConfigError: it asks for what a page cannot do, or a policy is not trained or does not fit.
    """
    refuse(config)
    session = Session(config)
    session.set_level(session.slider.value)  # by hand, as on the page
    engine, episodes, state = session.engine, session.engine.episodes, session.state
    scene, task, env = engine.scene, episodes.subtask, episodes.config
    sources = config.policies or {task.name: str(config.policy)}
    options = [_option(each, sources[each.name], session) for each in session.executor.table.options if each.stages]
    seen = sorted(inputs_of(task.next_stage, state))
    levels = torch.arange(1, env.comfort.levels + 1, dtype=torch.float64)
    limits = {"episode": env.task.max_episode_steps, "option": session.executor.table.options[0].time_limit or 0}
    made = {
        "xml": re.sub(r'(<texture[^>]*) class="/"', r"\1", scene.xml),  # MuJoCo 3.14 refuses it
        "assets": {name: base64.b64encode(file).decode() for name, file in scene.assets.items()},
        "looks": _looks(scene),
        "substeps": env.substeps,
        "action_repeat": env.task.action_repeat,
        "sensors": {key: [part.start, part.stop] for key, part in scene.sensors.items()},
        "moving": (scene.moving.reshape(2, -1) - [[1], [1 + scene.model.nq]]).tolist(),
        "home": scene.home.tolist(),
        "range": scene.joint_range.tolist(),
        "floor": scene.floor_z,
        "tcp_home": state.tcp_home[0].tolist(),
        "kind_places": state.kind_places[0].tolist(),
        "kinds": [{"shape": each.shape, "size": each.size_m, "rgb": each.rgb} for each in env.cell.objects.values()],
        "layout": episodes.draw.layout([0])[0].tolist(),
        "tops": state.tops[0].tolist(),
        "tolerances": {name: float(getattr(state, f"{name}_tolerance")) for name in ("grasp", "place", "home")},
        "stages": {
            "names": [stage.name for stage in task.stages],
            "object": [task.location(stage).value for stage in range(len(task.stages) + 1)],
            "points": [stage.at_point for stage in task.stages],
            "graph": traced(StageGraph(task, seen), state, seen),
        },
        "options": options,
        "retries": session.executor.retries,
        "limits": {name: max_episode_steps(levels, steps, env.comfort).tolist() for name, steps in limits.items()},
        "levels": next((option["levels"] for option in options if option["levels"]), None),
        "level": float(session.slider.value),
        "safety": safety(scene, env, session.walk),
        "hand": hand(scene, env),
        "body": _body(),
        "person": _person(config),
        "title": ", ".join(dict.fromkeys("/".join(Path(source).parts[-2:]) for source in sources.values())),
        "robot": env.robot.name,
    }
    made["episodes"] = [_episode(session) for _ in range(EPISODES)]
    session.close()
    return made


def _looks(scene: Scene) -> list[dict[str, Any]]:
    """Return what the page draws: of each body and colour a mesh in the body's frame.

    Vertices are int16 numbers of LOOK_UNIT_M, faces uint16 or uint32, both as base64.
    """
    model, found = dressed(scene).model, []
    for owner, meshes in body_meshes(model).items():
        for colour, mesh in meshes:
            floor, prop = owner == 0 and colour[3] == 1, model.body_mocapid[owner] >= scene.first_prop
            if floor or prop:  # the page has its own
                continue
            vertices = np.round(mesh.vertices / LOOK_UNIT_M).astype("<i2")
            faces = mesh.faces.astype("<u2" if len(vertices) < 1 << 16 else "<u4")
            look = {"body": owner, "colour": [round(value, 3) for value in colour], "wide": faces.itemsize == 4}
            found.append({**look, "vertices": _base64(vertices), "faces": _base64(faces)})
    return found


def _base64(values: NDArray[Any]) -> str:
    return base64.b64encode(values.tobytes()).decode()


def refuse(config: StudioConfig) -> None:
    """Raise ConfigError where a page cannot show what `config` says."""
    allowed: tuple[tuple[str, Any, Any], ...] = (
        ("task.action", config.task.action, "joint"),
        ("cell.vary.layouts", config.cell.vary.layouts, 0),
        ("human.clipping", config.human.clipping, "off"),
        ("human.others", ",".join(config.human.others) or "{}", "{}"),
        ("disturbance", config.disturbance, "none"),
        ("randomise", "given" if config.randomise.differs else "none", "none"),
        ("beside", config.beside, None),
        ("meta_controller.further_options", config.meta_controller.further_options, []),
    )
    for key, value, only in allowed:
        if value != only:
            raise ConfigError(f"{key}={value}: a page of export= has {key}={'null' if only is None else only} alone")
    if (top := config.meta_controller.name) not in ("none", "nearest"):
        raise ConfigError(f"meta_controller={top}: a page of export= runs options in order, and carries no controller")
    if config.task.name in SORTING:
        raise ConfigError(f"task={config.task.name}: a page of export= shows one policy, or a chain of them, once")
    for source in [config.policy] if config.policy else config.policies.values():
        if source is None or not Path(source).exists():
            raise ConfigError(f"policy={source!r}: export= takes a run folder, a checkpoint or a policy.pt")
        if load_policy(source).memory_dim is not None:
            raise ConfigError(f"policy={source!r} has a memory, which a page of export= does not keep")


def _option(option: Option, source: str, session: Session) -> dict[str, Any]:
    """Return a skill: its stages, the levels it was trained for, and its policy."""
    assert option.stages is not None
    env = environment(session.config)
    env = replace(env, task=replace(env.task, name=option.name))
    policy = load_policy(source)
    task = observed_by(policy, source, subtask(option.name), env)
    inputs = inputs_of(task.observe, session.state)
    if missing := set(inputs) - FIELDS:
        raise ConfigError(f"policy={source!r} observes {', '.join(sorted(missing))}, which a page does not have")
    graph = PolicyGraph(policy, task, inputs, math.radians(env.task.max_step_deg))
    return {
        "name": option.name,
        "first": option.stages.first,
        "last": option.stages.last,
        "levels": policy.spec["environment"].get("levels"),
        "graph": traced(graph, session.state, inputs),
    }


def _episode(session: Session) -> dict[str, Any]:
    """Return the next episode of `session`: its start, and what its person does beside the session's policies."""
    session.reset()
    engine, draw, parts, recorded = session.engine, session.engine.episodes.draw, [session.still().person], 0
    _, qpos, qvel = np.split(engine.physics_state[0], [1, 1 + engine.scene.model.nq])
    start = {
        "qpos": qpos.tolist(),
        "qvel": qvel.tolist(),
        "joint_target": session.state.joint_target[0].tolist(),
        "object": draw.objects([0])[0, 0].tolist(),
        "kind": int(draw.kinds[0, 0]),
        "points": draw.points[0].tolist(),
        "target_vel": session.state.target_vel[0].tolist(),
        **begun(session.state),
    }
    while recorded * CONTROL_STEP_S < RECORDED_S:
        if session.over:  # the person goes on, beside an arm that stands
            before = session.state
            result = engine.step(np.zeros((1, engine.episodes.action_dim)))
            clip = decision_clip(engine, before, result)
        else:
            clip = session.step().clip
        parts.append(clip.person[1:])
        recorded += len(clip.time) - 1
    return {**start, "walk": _packed(np.concatenate(parts))}


def _packed(person: NDArray[np.float64]) -> dict[str, Any]:
    """Return rows of a clip's person as float32, without limbs where none is given."""
    return constant(torch.from_numpy(person if np.isfinite(person[:, 5:]).any() else person[:, :5]).float())


def _body() -> dict[str, float]:
    return {
        "hip": body.HIP_M,
        "shoulder": body.SHOULDER_M,
        "hip_half": human.HIP_HALF_WIDTH_M,
        "shoulder_half": body.SHOULDER_HALF_WIDTH_M,
        "leg_radius": human.LEG_RADIUS_M,
        "upper_arm": body.UPPER_ARM_M,
        "forearm": body.FOREARM_M,
        "stretch": body.STRETCH,
        "height": body.HEIGHT_M,
    }


def _person(config: StudioConfig) -> dict[str, Any]:
    return {
        "far": FAR_AWAY_M,
        "farthest": FARTHEST_M,
        "entrance": ENTRANCE_M,
        "speed": min(motion_config("live").speed_m_s, fastest_m_s(config.safety)),
        "step_s": CONTROL_STEP_S,
        "full_swing": float(walk.FULL_SWING_RAD),
        "stride": walk.STRIDE_M,
        "smoothing": walk.SPEED_SMOOTHING,
        "arrived": ARRIVED_M,
    }
