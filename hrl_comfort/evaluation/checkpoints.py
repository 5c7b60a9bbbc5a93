"""Checkpoints of a run, or of a chain's runs: one after the other, or a grid of all their combinations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

from pandas import DataFrame
from rich.console import Console

from hrl_comfort.analysis.intervals import SHARE, Clusters
from hrl_comfort.analysis.tables import HEADLINE, cells, in_terminal
from hrl_comfort.config import ConfigError, EvaluateConfig
from hrl_comfort.evaluation.ledger import SHARES
from hrl_comfort.evaluation.rollout import Result, rollout
from hrl_comfort.files.atomic import all_or_none, overwrites
from hrl_comfort.files.documents import damaged
from hrl_comfort.files.provenance import policy_steps, step_files
from hrl_comfort.files.run_config import is_same, load_config, save_config
from hrl_comfort.files.tables import read_table, write_table
from hrl_comfort.plots.style import save_png
from hrl_comfort.plots.training import checkpoint_grid

BEST = 5
"""Combinations of a grid that are printed."""
Parts = Mapping[str, Path]
"""Checkpoints that act together, by the part of the chain; `policy` without one."""


def evaluate_in_order(config: EvaluateConfig) -> Path:
    """Evaluate every light checkpoint of a run, or of a chain's runs; write checkpoints.csv and their episodes.

    Raises:
      ConfigError: there is no checkpoint.
    """
    output = Path(config.output) / "checkpoints"
    every, rows = Result([], [], []), []
    for parts in checkpoints_of(config):
        result, found = _evaluate(config, parts)
        label = str(parts.get("policy") or " ".join(f"{name}={file}" for name, file in parts.items()))
        every.episodes += [replace(episode, policy=label) for episode in result.episodes]
        rows += found
    with all_or_none():
        write_table(output.parent / "checkpoints.csv", list(rows[0]), (row.values() for row in rows))
        every.write(output, config)
    _print(rows)
    return output


def evaluate_grid(config: EvaluateConfig) -> Path:
    """Evaluate every combination of the light checkpoints of a chain's runs; write grid.csv and grid.png.

    A part that is not a run folder is the same in all of them. The table grows by one combination at a time: the
    command goes on where it was stopped, or begins anew with `--overwrite`.

    Raises:
      ConfigError: fewer than two parts have several checkpoints.
    """
    output, found = Path(config.output), _found(config)
    varied = [name for name, files in found.items() if len(files) > 1]
    if len(varied) < 2:
        raise ConfigError(
            f"checkpoints=grid: {', '.join(varied) or 'no part'} has several checkpoints in checkpoints/; give two run "
            "folders or more as policies.*, or choose checkpoints=all"
        )
    rows = [] if overwrites() else _rows_so_far(output, config, found)
    done = {tuple(row[name] for name in found) for row in rows}
    if done:
        print(f"{len(done)} combinations are in {output / 'grid.csv'}; --overwrite measures them again")
    for files in product(*found.values()):
        if tuple(map(policy_steps, files)) in done:
            continue
        latest = _evaluate(config, dict(zip(found, files, strict=True)))[1]
        if not rows:  # what is there is of another command
            for name in ("grid.csv", "grid.png"):
                (output / name).unlink(missing_ok=True)
            save_config(config, output / "config.yaml")
        rows += latest
        write_table(output / "grid.csv", list(rows[0]), (row.values() for row in rows))
    save_png(checkpoint_grid(DataFrame(rows), varied), output / "grid.png")
    _print(sorted(rows, key=lambda row: -row["success"])[:BEST], varied)
    return output


def _rows_so_far(output: Path, config: EvaluateConfig, parts: Mapping[str, Sequence[Path]]) -> list[dict[str, Any]]:
    """Return the rows of grid.csv in `output` if the same command wrote them of the same checkpoints, else none.

    Raises:
      ConfigError: the table is damaged.
    """
    if not (output / "config.yaml").is_file() or not is_same(load_config(output), config):
        return []
    file = output / "grid.csv"
    if (table := read_table(file)) is None:
        return []
    if any(each.stat().st_mtime > file.stat().st_mtime for files in parts.values() for each in files):
        return []
    try:
        table = table.astype(dict.fromkeys((*parts, "episodes"), "int64"))
    except (KeyError, TypeError, ValueError) as error:
        raise damaged(file, error) from None
    return table.astype(object).where(table.notna(), None).to_dict("records")


def checkpoints_of(config: EvaluateConfig) -> list[dict[str, Path]]:
    """Return the checkpoints to evaluate together by the part of the chain (`policy` without one), oldest first.

    Trainings of parts differ in length. At each checkpoint of the part that has most, the others join with the one
    nearest in fraction of their own training so far. A part without checkpoints stays as it is.

    Raises:
      ConfigError: there is no checkpoint.
    """
    found = _found(config)

    def fraction(file: Path, name: str) -> float:
        return policy_steps(file) / policy_steps(found[name][-1])

    most = max(found, key=lambda name: len(found[name]))
    at = [fraction(file, most) for file in found[most]]
    return [{k: min(files, key=lambda file: abs(fraction(file, k) - x)) for k, files in found.items()} for x in at]


def _found(config: EvaluateConfig) -> dict[str, list[Path]]:
    """Return the light checkpoints of each part that has some; raise ConfigError if none has."""
    sources = config.policies or {"policy": config.policy or ""}
    found = {name: step_files(Path(source) / "checkpoints") for name, source in sources.items()}
    found = {name: files for name, files in found.items() if files}
    if not found:
        where = " ".join(f"{name}={source}" for name, source in sources.items())
        asked = f"checkpoints={config.checkpoints}"
        raise ConfigError(f"{asked}: {where} holds no step_*.pt in checkpoints/; give the folder of a run")
    return found


def _evaluate(config: EvaluateConfig, parts: Parts) -> tuple[Result, list[dict[str, Any]]]:
    """Return the episodes of checkpoints that act together, and a row of the table for each level."""
    files = {name: str(path) for name, path in parts.items()}
    alone = files.get("policy")
    result = rollout(replace(config, policy=alone, policies={**config.policies, **files} if alone is None else {}))
    fixed = config.comfort.level if config.comfort.source == "fixed" else None
    at_levels = result.table.groupby("comfort_level") if config.levels else [(fixed, result.table)]
    return result, [_row(parts, level, episodes) for level, episodes in at_levels]


def _row(parts: Parts, level: Any, episodes: DataFrame) -> dict[str, Any]:
    """Return a row of the table; of a chain with the policy steps of each part."""
    steps = {name: policy_steps(file) for name, file in parts.items()}
    row = episodes.iloc[0][["task", "human", "split", "precision_m"]].to_dict()
    row |= {"comfort_level": level, "episodes": len(episodes), "policy_steps": sum(steps.values())}
    for name, share in Clusters.of(episodes).estimates(episodes[list(SHARES)], dict.fromkeys(SHARES, SHARE)).items():
        low, high = share["ci95"] or (None, None)
        row |= {name: share["mean"], f"{name}_low": low, f"{name}_high": high}
    return row if "policy" in steps else {**row, **steps}


def _print(rows: Sequence[Mapping[str, Any]], parts: Sequence[str] = ("policy_steps",)) -> None:
    shown = {name: HEADLINE[name] for name in SHARES}
    lines = []
    for row in rows:
        bounds = {name: (row[f"{name}_low"], row[f"{name}_high"]) for name in SHARES}
        shares = {n: {"mean": row[n], "ci95": None if each[0] is None else [*each]} for n, each in bounds.items()}
        level = "-" if row["comfort_level"] is None else f"{row['comfort_level']:g}"
        lines.append([*(f"{row[part]:,}" for part in parts), level, *cells(shares, shown)])
    heads = [part.replace("_", " ") for part in parts]
    Console().print(in_terminal([], [*heads, "level", *(each.label for each in shown.values())], lines))
