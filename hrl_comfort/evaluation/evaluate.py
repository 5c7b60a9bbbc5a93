"""Evaluation of a policy or a chain of policies, or of the checkpoints of either, on one split."""

from __future__ import annotations

import warnings
from pathlib import Path

import torch
from rich.console import Console

from hrl_comfort.analysis.summary import with_totals
from hrl_comfort.analysis.tables import of_groups
from hrl_comfort.config import EvaluateConfig
from hrl_comfort.config.checks import one_of
from hrl_comfort.evaluation.checkpoints import evaluate_grid, evaluate_in_order
from hrl_comfort.evaluation.episode import COLUMNS
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.evaluation.terminal_states import record_terminal_states
from hrl_comfort.files.output import EVALUATION_MARKS, output_file, output_folder


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
        one_of("group_by", name, COLUMNS)
    output = Path(config.output)
    with output_folder(output, EvaluateConfig, *EVALUATION_MARKS):
        if (output / "summary.json").is_file() and config.checkpoints == "none":
            warnings.warn(f"{output} holds an earlier evaluation, which this one replaces at its end", stacklevel=2)
        if config.checkpoints == "all":
            output = evaluate_in_order(config)
        elif config.checkpoints == "grid":
            output = evaluate_grid(config)
        else:
            result = rollout(config)
            summary = result.write(output, config)
            Console().print(of_groups(with_totals(summary["groups"], result.table)))
    print(output)
    return output
