"""Evaluation of a policy, of every checkpoint of a run, or of a chain of policies, on one split."""

from __future__ import annotations

import warnings
from pathlib import Path

import torch
from rich.console import Console

from hrl_comfort.agents import checkpoint
from hrl_comfort.analysis.episodes import success
from hrl_comfort.analysis.summary import with_totals
from hrl_comfort.analysis.tables import cell, in_terminal, of_groups
from hrl_comfort.config import ConfigError, EvaluateConfig
from hrl_comfort.evaluation.episode import COLUMNS
from hrl_comfort.evaluation.rollout import Result, rollout
from hrl_comfort.evaluation.terminal_states import record_terminal_states
from hrl_comfort.files.atomic import all_or_none
from hrl_comfort.files.output import EVALUATION_MARKS, output_file, output_folder
from hrl_comfort.files.tables import write_table


def evaluate(config: EvaluateConfig) -> Path:
    """Evaluate a policy or chain; return the folder that holds episodes.csv and summary.json, or the terminal states.

    Raises:
      ConfigError: no such policy, or one of another subtask.
    """
    torch.set_num_threads(1)
    if config.terminal_states is not None:
        with output_file(Path(config.terminal_states)):
            return record_terminal_states(config)
    for name in config.group_by:
        if name not in COLUMNS:
            raise ConfigError(f"group_by={name!r} is not a column; choose among {', '.join(COLUMNS)}")
    output = Path(config.output)
    with output_folder(output, EvaluateConfig, *EVALUATION_MARKS):
        if (output / "summary.json").is_file() and config.checkpoints == "none":
            warnings.warn(f"{output} holds an earlier evaluation, which this one replaces at its end", stacklevel=2)
        if config.checkpoints == "all":
            output = evaluate_checkpoints(config)
        else:
            result = rollout(config)
            summary = result.write(output, config)
            Console().print(of_groups(with_totals(summary["groups"], result.table)))
    print(output)
    return output


def evaluate_checkpoints(config: EvaluateConfig) -> Path:
    """Evaluate every light checkpoint of the run `policy`; write checkpoints.csv and their episodes."""
    folder = Path(config.policy or "")
    found = checkpoint.steps(folder / "checkpoints")
    if not found:
        raise ConfigError(f"checkpoints=all: {folder}/checkpoints holds no step_*.pt; policy must be a run folder")
    output = Path(config.output) / "checkpoints"
    every, curve, lines = Result([], [], []), [], []
    for path in found:
        result = rollout(config, str(path))
        every.episodes += result.episodes
        share = success(result.table)
        policy_steps = int(path.stem.removeprefix("step_"))
        interval = share["ci95"] or (None, None)
        lines.append([f"{policy_steps:,}", cell(share, 100)])
        curve.append([policy_steps, share["mean"], *interval, config.task.precision.grasp_tolerance_m])
    header = ["policy_steps", "success", "success_low", "success_high", "precision_m"]
    with all_or_none():
        write_table(output.parent / "checkpoints.csv", header, curve)
        every.write(output, config)
    Console().print(in_terminal([], ["policy steps", "success (%)"], lines))
    return output
