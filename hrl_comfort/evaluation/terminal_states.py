"""Terminal states of a policy, recorded as starts of the subtask that follows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console

from hrl_comfort.config import RANDOM, TERMINAL_STATES_SEED, ConfigError, EvaluateConfig
from hrl_comfort.evaluation.rollout import BATCH
from hrl_comfort.files.atomic import write_atomically
from hrl_comfort.files.run_config import environment
from hrl_comfort.hierarchy.controllers import make_executor
from hrl_comfort.hierarchy.executor import execute
from hrl_comfort.sim.processes.engine import make_engine
from hrl_comfort.sim.starts import fingerprint


class NoSuccess(ConfigError):
    """No episode of a kind succeeded, so there are no terminal states of it."""


def record_terminal_states(config: EvaluateConfig, first_seed: int = TERMINAL_STATES_SEED) -> Path:
    """Write the last states of successful episodes by kind, float32 (`sim.starts`), to `config.terminal_states`.

    A state holds the joints, with a gripper all bodies, the set-point of the fingers and the sizes that
    `randomise.object_size` draws, and, with people, the first one's position and the level in force. Episodes are drawn
    as in training, from seeds of their own, `first_seed` on: what is recorded becomes training data.

    Raises:
      ConfigError: the path does not end in .npz, or episodes have one kind alone.
      NoSuccess: no episode of a kind succeeded.
    """
    path = Path(config.terminal_states or "")
    if path.suffix != ".npz":
        raise ConfigError(f"terminal_states={config.terminal_states!r} must be the path of an .npz file")
    if config.task.object != RANDOM:
        raise ConfigError(f"terminal_states= needs every kind; task.object={config.task.object!r} makes one")
    torch.set_num_threads(1)
    found: dict[str, list[np.ndarray]] = {kind: [] for kind in config.cell.kinds}
    for begin in range(0, config.episodes, BATCH):
        rows = min(BATCH, config.episodes - begin)
        for kind, state in successes(config, rows, first_seed + begin // BATCH):
            found[kind].append(state)
    for kind, states in found.items():
        if not states:
            raise NoSuccess(f"terminal_states={str(path)!r}: no {kind} episode succeeded, so none is written")
    banks: dict[str, Any] = {kind: np.array(states) for kind, states in found.items()}
    if config.cell.vary.layouts or config.robot.gripper.holds:
        banks["cell"] = np.array(fingerprint(environment(config)))
    write_atomically(path, lambda file: np.savez(file, **banks))
    count = sum(map(len, found.values()))
    Console().print(f"{path}: {count} terminal states of {config.episodes} episodes", soft_wrap=True)
    return path


def successes(config: EvaluateConfig, rows: int, seed: int) -> list[tuple[str, np.ndarray]]:
    """Run an episode, drawn as in training, in each of `rows` cells; return kind and last state of successes."""
    engine = make_engine(environment(config), rows, seed)
    executor, top = make_executor(config, None, engine, seed)
    engine.reset()
    found = []
    for executed in execute(engine, executor, top):
        state = executed.result.state
        parts = [state.joint_pos, state.joint_vel, state.joint_target]
        if config.robot.gripper.holds:  # sensors lag behind the bodies by a physics step
            physics = torch.from_numpy(engine.physics_state)
            parts = [physics[:, engine.scene.moving], state.joint_target, physics[:, 1:], state.grip_target[:, None]]
        if config.randomise.resized:
            parts += [torch.from_numpy(engine.episodes.draw.factors[:, 2])]
        if config.human.motion != "none":
            parts += [state.humans_pos[:, 0], executed.result.level[:, None]]
        if config.cell.vary.layouts:
            nobody = config.human.motion == "none"
            parts += [torch.full((rows, 3), torch.nan)] * nobody + [torch.from_numpy(engine.episodes.draw.layout_id)]
        states = torch.cat(parts, dim=-1).numpy().astype(np.float32)
        for row in torch.nonzero(executed.ended & executed.result.success).squeeze(-1).tolist():
            found.append((config.cell.kinds[int(state.target_kind[row])], states[row].copy()))
    engine.close()
    return found
