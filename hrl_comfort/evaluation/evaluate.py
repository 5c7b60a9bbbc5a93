"""Evaluation of a policy or a chain of policies, or of every checkpoint of either, on one split."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from pandas import DataFrame
from rich.console import Console

from hrl_comfort.analysis.intervals import SHARE, Clusters, Estimate
from hrl_comfort.analysis.summary import with_totals
from hrl_comfort.analysis.tables import HEADLINE, cells, in_terminal, of_groups
from hrl_comfort.config import ConfigError, EvaluateConfig
from hrl_comfort.config.checks import one_of
from hrl_comfort.evaluation.episode import COLUMNS
from hrl_comfort.evaluation.ledger import SHARES
from hrl_comfort.evaluation.rollout import Result, rollout
from hrl_comfort.evaluation.terminal_states import record_terminal_states
from hrl_comfort.files.atomic import all_or_none
from hrl_comfort.files.output import EVALUATION_MARKS, output_file, output_folder
from hrl_comfort.files.provenance import policy_steps, step_files
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
        one_of("group_by", name, COLUMNS)
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
    """Evaluate every light checkpoint of a run, or of a chain's runs; write checkpoints.csv and their episodes.

    Raises:
      ConfigError: there is no checkpoint.
    """
    output = Path(config.output) / "checkpoints"
    every, rows, lines = Result([], [], []), [], []
    shown = {name: HEADLINE[name] for name in SHARES}
    fixed = config.comfort.level if config.comfort.source == "fixed" else None
    for parts in checkpoints_of(config):
        files = {name: str(path) for name, path in parts.items()}
        alone = files.get("policy")
        result = rollout(replace(config, policy=alone, policies={**config.policies, **files} if alone is None else {}))
        label = alone or " ".join(f"{name}={file}" for name, file in files.items())
        every.episodes += [replace(episode, policy=label) for episode in result.episodes]
        for level, episodes in result.table.groupby("comfort_level") if config.levels else [(fixed, result.table)]:
            shares = Clusters.of(episodes).estimates(episodes[list(SHARES)], dict.fromkeys(SHARES, SHARE))
            rows.append(row := _row(parts, level, episodes, shares))
            lines.append([f"{row['policy_steps']:,}", str(level or "-"), *cells(shares, shown)])
    with all_or_none():
        write_table(output.parent / "checkpoints.csv", list(rows[0]), (row.values() for row in rows))
        every.write(output, config)
    Console().print(in_terminal([], ["policy steps", "level", *(each.label for each in shown.values())], lines))
    return output


def checkpoints_of(config: EvaluateConfig) -> list[dict[str, Path]]:
    """Return the checkpoints to evaluate together by the part of the chain (`policy` without one), oldest first.

    Trainings of parts differ in length. At each checkpoint of the part that has most, the others join with the one
    nearest in fraction of their own training so far. A part without checkpoints stays as it is.

    Raises:
      ConfigError: there is no checkpoint.
    """
    sources = config.policies or {"policy": config.policy or ""}
    found = {name: step_files(Path(source) / "checkpoints") for name, source in sources.items()}
    found = {name: files for name, files in found.items() if files}
    if not found:
        where = " ".join(f"{name}={source}" for name, source in sources.items())
        raise ConfigError(f"checkpoints=all: {where} holds no step_*.pt in checkpoints/; give the folder of a run")

    def fraction(file: Path, name: str) -> float:
        return policy_steps(file) / policy_steps(found[name][-1])

    most = max(found, key=lambda name: len(found[name]))
    at = [fraction(file, most) for file in found[most]]
    return [{k: min(files, key=lambda file: abs(fraction(file, k) - x)) for k, files in found.items()} for x in at]


def _row(
    parts: Mapping[str, Path], level: int | None, episodes: DataFrame, shares: Mapping[str, Estimate]
) -> dict[str, Any]:
    """Return a row of checkpoints.csv; of a chain with the policy steps of each part."""
    steps = {name: policy_steps(file) for name, file in parts.items()}
    row = episodes.iloc[0][["task", "human", "split", "precision_m"]].to_dict()
    row |= {"comfort_level": level, "episodes": len(episodes), "policy_steps": sum(steps.values())}
    for name, share in shares.items():
        low, high = share["ci95"] or (None, None)
        row |= {name: share["mean"], f"{name}_low": low, f"{name}_high": high}
    return row if "policy" in steps else {**row, **steps}
