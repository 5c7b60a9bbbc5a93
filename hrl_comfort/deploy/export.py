"""`hrl-comfort export`: trained policies as ONNX files for other programs."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from hrl_comfort.config import ConfigError, ExportConfig
from hrl_comfort.files.atomic import all_or_none, write_json
from hrl_comfort.files.output import output_folder
from hrl_comfort.files.run_config import environment, save_config
from hrl_comfort.policies.actor import load_policy
from hrl_comfort.policies.graph import PolicyGraph, description, inputs_of, write_onnx
from hrl_comfort.policies.load import observed_by
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.hand.fingers import CLOSING_S


def fingers_of(scene: Scene) -> dict[str, Any]:
    """Return the ends of the drive of a hand and the least time from one to the other; empty without a gripper."""
    if scene.gripper is None:
        return {}
    opened, closed = scene.model.actuator_ctrlrange[len(scene.joints)].tolist()
    return {"gripper": {"name": scene.gripper.name, "open": opened, "closed": closed, "closing_s": CLOSING_S}}


def export(config: ExportConfig) -> Path:
    """Write OPTION.onnx for each policy, with its joint order and limits in policies.json; return the folder.

    Raises:
      ConfigError: the folder holds other files, or a policy is not trained, does not fit its subtask, or moves the
        tool in Cartesian space.
    """
    if config.task.action != "joint":
        raise ConfigError(f"task.action={config.task.action}: only policies of joint increments can be exported")
    sources: dict[str, str | None] = {**config.policies} or {config.task.name: config.policy}
    if "meta_controller" in sources:
        raise ConfigError("policies.meta_controller: export writes skills, not what chooses among them; leave it out")
    output, options = Path(config.output), []
    with output_folder(output, ExportConfig, "config.yaml"), all_or_none():
        for name, source in sources.items():
            if source is None or not Path(source).exists():
                raise ConfigError(f"policy={source!r}: export takes a run folder, a checkpoint or a policy.pt")
            env = environment(replace(config, task=replace(config.task, name=name)))
            policy = load_policy(source)
            if policy.memory_dim is not None:
                raise ConfigError(f"policy={source!r} has a memory; export takes those that act by what they see now")
            engine = Engine(env, 2, 0)
            task = observed_by(policy, source, engine.episodes.subtask, env)
            state, scene = engine.reset(), engine.scene
            inputs = inputs_of(task.observe, state)
            about = description(task, inputs, env, policy.spec)
            graph = PolicyGraph(policy, task, inputs, math.radians(env.task.max_step_deg))
            write_onnx(graph, state, inputs, about, output / f"{name}.onnx")
            options.append({"file": f"{name}.onnx", "policy": source, **about})
        made = {
            "options": options,
            "joint_names": [scene.model.joint(index).name for index in range(len(scene.home))],
            "joint_limits_rad": scene.joint_range.tolist(),
            "home_rad": scene.home.tolist(),
            **fingers_of(scene),
        }
        write_json(output / "policies.json", made)
        save_config(config, output / "config.yaml")
    Console().print(f"{output}: {', '.join(option['file'] for option in options)}, policies.json", soft_wrap=True)
    return output
