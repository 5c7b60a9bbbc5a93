"""`hrl-comfort figure`: reads evaluations, draws one figure, and writes it with its numbers."""

from __future__ import annotations

import glob
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure
from pandas import DataFrame
from rich.console import Console

from hrl_comfort.analysis import comparison, level_change, option_use, tables
from hrl_comfort.analysis import handover as handovers
from hrl_comfort.analysis.comfort import DISTANCE, SPEED, STEPS, common, of_spawns, paired, summarise
from hrl_comfort.analysis.episodes import chain_lengths
from hrl_comfort.config import FIGURES, ConfigError, FigureConfig
from hrl_comfort.config.checks import implemented
from hrl_comfort.files.atomic import all_or_none, write_json
from hrl_comfort.files.output import output_file
from hrl_comfort.files.run_folder import Run, read_run
from hrl_comfort.plots import hierarchy, levels, paths
from hrl_comfort.plots.option_use import option_use as options_drawn
from hrl_comfort.plots.style import save_png

Groups = Mapping[str, Sequence[Run]]
"""Evaluations by the name they have in the figure."""
Drawn = tuple[Figure, dict[str, Any]]
"""A figure and its numbers; no numbers, no file of them."""


def figure(config: FigureConfig) -> Path:
    """Draw what `config` asks for; return the PNG.

    Raises:
      ConfigError: an evaluation is not there, is damaged, or lacks what the figure needs.
    """
    output = Path(config.output)
    with output_file(output, ".json"), all_or_none():
        _draw(config, output)
    Console(stderr=True).print(f"{output}", soft_wrap=True)
    return output


def _draw(config: FigureConfig, output: Path) -> None:
    folders = folders_of(config)
    if config.kind == "handover":  # made from other tables than episodes.csv
        numbers = {label: handovers.summarise(each) for label, each in folders.items()}
        picture = hierarchy.handover(numbers)
    else:
        groups = {label: [_evaluation(folder) for folder in each] for label, each in folders.items()}
        picture, numbers = KINDS[config.kind](config, groups)
    if config.kind in TABLES:
        print(TABLES[config.kind](numbers), end="")
    save_png(picture, output)
    if numbers:
        write_json(output.with_suffix(".json"), numbers)


def folders_of(config: FigureConfig) -> dict[str, list[Path]]:
    """Return the folders that the names and patterns of `config` stand for, those of one label together."""
    groups: dict[str, list[Path]] = {}
    for i, pattern in enumerate(config.evaluations):
        names = [pattern] if Path(pattern).is_dir() else sorted(glob.glob(pattern))
        folders = [Path(name) for name in names if Path(name).is_dir()]
        if not folders:
            raise ConfigError(f"evaluations={pattern!r} is not the folder of an evaluation")
        label = config.labels[i] if config.labels else pattern.removesuffix("/").removesuffix("/eval")
        groups.setdefault(label, []).extend(folders)
    return groups


def _evaluation(folder: Path) -> Run:
    run = read_run(folder)
    if run.episodes is None:
        raise ConfigError(f"evaluations={str(folder)!r} holds no episodes.csv with an episode in it")
    return run


def _everything(groups: Groups) -> list[Run]:
    return [run for runs in groups.values() for run in runs]


def _levels(config: FigureConfig, groups: Groups) -> Drawn:
    data = paired(_everything(groups))
    measures = (SPEED,) if config.kind == "speed" else (DISTANCE, STEPS)
    return levels.levels(data, config.over, *measures), summarise(data)


def _plane(config: FigureConfig, groups: Groups) -> Drawn:
    data = {label: paired(runs) for label, runs in groups.items()}
    numbers: dict[str, dict[str, Any]] = {label: {"each": summarise(each)} for label, each in data.items()}
    if config.over == "pairs":  # rates of episodes chosen for their success would say nothing
        data = common(data)
        for label, each in data.items():
            found = of_spawns(each)["levels"]
            numbers[label]["in_common"] = [{"level": at["level"], **at["pairs"]} for at in found]
    return levels.plane(data, config.over), numbers


def _people(config: FigureConfig, groups: Groups) -> Drawn:
    runs = _everything(groups)
    motions = [str(run.episodes["human"].iloc[0]) for run in runs if run.episodes is not None]
    names = list(groups) if config.labels or len(set(motions)) < len(runs) else [m.replace("_", " ") for m in motions]
    if len(names) != len(runs):
        raise ConfigError("kind=people takes one evaluation a motion: give each folder a label of its own")
    return paths.people(dict(zip(names, runs, strict=True)), config.levels, config.episodes), {}


def _jump(config: FigureConfig, groups: Groups) -> Drawn:
    assert config.jump_s is not None, "FigureConfig checks it"
    if len(groups) != 2:
        raise ConfigError(f"evaluations={list(config.evaluations)} must be two: without the jump, and with it")
    without, jumping = groups.values()
    data = level_change.aligned(without, jumping, config.jump_s)
    return levels.jump(data), level_change.numbers(data)


def _options(run: Run) -> DataFrame:
    if run.config.get("levels"):
        raise ConfigError(f"{run.folder} is of several levels; options are drawn of one (comfort.level=)")
    if run.options is None:
        raise ConfigError(
            f"{run.folder} holds no options.csv; evaluate with a controller, meta_controller=nearest, say"
        )
    return run.options


def _timeline(config: FigureConfig, groups: Groups) -> Drawn:
    runs = _everything(groups)
    if len(runs) != 1:
        raise ConfigError(f"evaluations={list(config.evaluations)} must be one: kind=timeline draws one")
    return hierarchy.timeline(_options(runs[0]), config.episodes), {}


def _pooled(runs: Sequence[Run]) -> tuple[DataFrame, DataFrame]:
    """Return episodes and options of several evaluations; an episode's number tells which of them it belongs to."""
    named = [
        [frame.assign(episode=f"{i}/" + frame["episode"].astype("str")) for frame in (run.episodes, _options(run))]
        for i, run in enumerate(runs)
        if run.episodes is not None
    ]
    episodes, options = (pd.concat(frames, ignore_index=True) for frames in zip(*named, strict=True))
    return episodes, options


def _chain(config: FigureConfig, groups: Groups) -> Drawn:
    numbers = {label: chain_lengths(*_pooled(runs)) for label, runs in groups.items()}
    return hierarchy.chain(numbers), dict(numbers)


def _option_use(config: FigureConfig, groups: Groups) -> Drawn:
    for run in _everything(groups):
        if "cause" not in _options(run):
            raise ConfigError(f"{run.folder} does not say why its options ended; evaluate again with --overwrite")
    pools = {label: _pooled(runs) for label, runs in groups.items()}
    options = {label: option_use.with_kinds(of) for label, (_, of) in pools.items()}
    numbers = {label: option_use.summarise(pools[label][0], each) for label, each in options.items()}
    return options_drawn(options), numbers


def _comparison(config: FigureConfig, groups: Groups) -> Drawn:
    of = {
        "controllers": (comparison.controllers, comparison.PARTS),
        "divisions": (comparison.divisions, comparison.RESULTS),
    }
    compare, names = of[config.kind]
    numbers = compare(groups)
    return hierarchy.comparison(numbers[config.kind], names), dict(numbers)


_KINDS: dict[str, Callable[[FigureConfig, Groups], Drawn]] = {
    "levels": _levels,
    "speed": _levels,
    "plane": _plane,
    "paths": lambda config, groups: (paths.at_levels(_everything(groups), config.levels, config.episodes), {}),
    "people": _people,
    "jump": _jump,
    "timeline": _timeline,
    "chain": _chain,
    "options": _option_use,
    "controllers": _comparison,
    "divisions": _comparison,
}
KINDS = implemented(tuple(name for name in FIGURES if name != "handover"), _KINDS)
TABLES: dict[str, Callable[[dict[str, Any]], str]] = {
    "levels": tables.levels,
    "options": option_use.table,
    "controllers": comparison.table,
    "divisions": comparison.table,
    "handover": handovers.table,
}
"""Kinds of figures that print their numbers as a table."""
