"""Recording how a policy leaves the arm: the starts of the subtask after it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from rich.console import Console

from hrl_comfort.config import TERMINAL_STATES_SEED, ConfigError, EvaluateConfig
from hrl_comfort.config.compose import environment
from hrl_comfort.evaluation.controllers import make_controller
from hrl_comfort.evaluation.rollout import CHUNK, COLOURS
from hrl_comfort.files.atomic import write_atomically
from hrl_comfort.hierarchy.play import play
from hrl_comfort.sim.engine import Engine


def record_terminal_states(config: EvaluateConfig) -> Path:
    """Write how successful episodes end (`sim.starts`), by colour, to `config.endings`, float32.

    With the joints goes where the person stood and the level in force, unless nobody is there.

    Episodes are drawn as in training, from seeds of their own: what is recorded becomes training data, and
    the evaluation set stays held out.

    Raises:
      ConfigError: the file's name is not one of an .npz, or no episode of a colour succeeded.
    """
    path = Path(config.terminal_states or "")
    if path.suffix != ".npz":
        raise ConfigError(f"terminal_states={config.terminal_states!r} must be the path of an .npz file")
    if config.task.colour != "random":
        raise ConfigError(f"terminal_states= needs both colours; task.colour={config.task.colour!r} makes one")
    torch.set_num_threads(1)
    found: dict[str, list[np.ndarray]] = {colour: [] for colour in COLOURS}
    for begin in range(0, config.episodes, CHUNK):
        rows = min(CHUNK, config.episodes - begin)
        for colour, termination in successes(config, rows, TERMINAL_STATES_SEED + begin // CHUNK):
            found[colour].append(termination)
    for colour, terminal_states in found.items():
        if not terminal_states:
            raise ConfigError(f"terminal_states={str(path)!r}: no {colour} episode succeeded, so none is written")
    orange, pink = (np.array(found[colour]) for colour in COLOURS)
    write_atomically(path, lambda file: np.savez(file, orange=orange, pink=pink))
    count = sum(map(len, found.values()))
    Console().print(f"{path}: {count} endings, of {config.episodes} episodes", soft_wrap=True)
    return path


def successes(config: EvaluateConfig, rows: int, seed: int) -> list[tuple[str, np.ndarray]]:
    """Run one training-drawn episode in each of `rows` cells; return colour and ending of successes."""
    engine = Engine(environment(config), rows, seed)
    controller = make_controller(config, None, engine, seed)
    engine.reset()
    found = []
    for moment in play(engine, controller):
        state = moment.outcome.state
        parts = [state.joint_pos, state.joint_vel, state.joint_target]
        if config.human.motion != "none":
            parts += [state.human_pos, moment.outcome.level[:, None]]
        terminal_states = torch.cat(parts, dim=-1).numpy().astype(np.float32)
        for row in torch.nonzero(moment.ended & moment.outcome.success).squeeze(-1).tolist():
            found.append((COLOURS[int(state.colour[row])], terminal_states[row].copy()))
    engine.close()
    return found
