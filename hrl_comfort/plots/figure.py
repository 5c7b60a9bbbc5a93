"""`hrl-comfort figure`: reads evaluations, draws one figure, and writes it with its numbers."""

from __future__ import annotations

import glob
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure
from pandas import DataFrame
from rich.console import Console

from hrl_comfort.analysis import tables
from hrl_comfort.analysis.comfort import Limit, Paired, common, of_spawns, paired, summarise
from hrl_comfort.analysis.episodes import chain_lengths
from hrl_comfort.config import ConfigError, FigureConfig
from hrl_comfort.files.atomic import write_json
from hrl_comfort.files.run_folder import Run, read_run
from hrl_comfort.plots import controllers, divisions, handover, level_change, levels, options
from hrl_comfort.plots import paths as path_figures
from hrl_comfort.plots.style import save_png

Groups = dict[str, list[Run]]
"""Evaluations by the name they have in the figure."""
Drawn = tuple[Figure, dict[str, Any]]
"""A figure and its numbers; no numbers, no file of them."""


def figure(config: FigureConfig) -> Path:
    """Draw what `config` asks for; return the PNG.

    Raises:
      ConfigError: an evaluation is not there, is damaged, or lacks what the figure needs.
    """
    if config.kind == "handover":  # made from other tables than episodes.csv
        numbers = handover.summarise(folders_of(config))
        print(handover.table(numbers), end="")
        picture = handover.draw(numbers)
    else:
        picture, numbers = KINDS[config.kind](config, read_groups(config))
    output = Path(config.output)
    save_png(picture, output)
    if numbers:
        write_json(output.with_suffix(".json"), numbers)
    Console(stderr=True).print(f"{output}", soft_wrap=True)
    return output


def read_groups(config: FigureConfig) -> Groups:
    """Return the evaluations that `config` names, those of one label together."""
    return {label: [_evaluation(each) for each in folders] for label, folders in folders_of(config).items()}


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


def _paired(runs: list[Run]) -> Paired:
    return paired([(run.episodes, _limit(run)) for run in runs if run.episodes is not None])


def _limit(run: Run) -> Limit:
    """Return the time limit by level: as `comfort.adapt.max_episode_steps`, it grows where speed is paid for.

    From the plain YAML, so that evaluations of other versions can be drawn too.
    """
    steps = run.config.get("task", {}).get("max_episode_steps")
    if steps is None:
        raise ConfigError(f"{run.folder}/config.yaml lacks task.max_episode_steps, at which failures count")
    comfort = run.config.get("comfort", {})
    if not comfort.get("beta"):
        return lambda level: int(steps)
    return lambda level: math.ceil(steps * comfort["levels"] / level)


def _everything(groups: Groups) -> list[Run]:
    return [run for runs in groups.values() for run in runs]


def _levels(config: FigureConfig, groups: Groups) -> Drawn:
    data = _paired(_everything(groups))
    numbers = summarise(data)
    print(tables.levels(numbers), end="")
    return levels.levels(data, config.over), numbers


def _speed(config: FigureConfig, groups: Groups) -> Drawn:
    data = _paired(_everything(groups))
    return levels.speed(data, config.over), summarise(data)


def _plane(config: FigureConfig, groups: Groups) -> Drawn:
    whole = {label: _paired(runs) for label, runs in groups.items()}
    data = common(whole) if config.over == "pairs" else whole
    numbers: dict[str, dict[str, Any]] = {label: {"each": summarise(each)} for label, each in whole.items()}
    if config.over == "pairs":  # rates of episodes chosen for their success would say nothing
        for label, each in data.items():
            found = of_spawns(each)["levels"]
            numbers[label]["in_common"] = [{"level": at["level"], **at["pairs"]} for at in found]
    return levels.plane(data, config.over), numbers


def _paths(config: FigureConfig, groups: Groups) -> Drawn:
    return path_figures.paths(_everything(groups), config.levels, config.episodes), {}


def _people(config: FigureConfig, groups: Groups) -> Drawn:
    runs = _everything(groups)
    motions = [str(run.episodes["human"].iloc[0]) for run in runs if run.episodes is not None]
    if not config.labels and len(set(motions)) == len(runs):
        named = {name.replace("_", " "): run for name, run in zip(motions, runs, strict=True)}
    elif len(groups) == len(runs):
        named = {label: run for label, (run,) in groups.items()}
    else:
        raise ConfigError("kind=people takes one evaluation a motion: give each folder a label of its own")
    return path_figures.people(named, config.levels, config.episodes), {}


def _jump(config: FigureConfig, groups: Groups) -> Drawn:
    assert config.jump_s is not None, "FigureConfig checks it"
    if len(groups) != 2:
        raise ConfigError(f"evaluations={list(config.evaluations)} must be two: without the jump, and with it")
    without, jumping = groups.values()
    data = level_change.aligned(without, jumping, config.jump_s)
    return level_change.jump(data), level_change.numbers(data)


def _options(run: Run) -> DataFrame:
    if run.config.get("levels"):
        raise ConfigError(f"{run.folder} is of several levels; options are drawn of one (comfort.level=)")
    if run.options is None:
        raise ConfigError(
            f"{run.folder} holds no options.csv; evaluate with a controller, meta_controller=scripted, say"
        )
    return run.options


def _timeline(config: FigureConfig, groups: Groups) -> Drawn:
    runs = _everything(groups)
    if len(runs) != 1:
        raise ConfigError(f"evaluations={list(config.evaluations)} must be one: kind=timeline draws one")
    rows = _options(runs[0])
    there = rows["episode"].unique().tolist()
    chosen = list(config.episodes) or there[: options.SHOWN_TIMELINES]
    missing = [episode for episode in chosen if episode not in there]
    if missing:
        raise ConfigError(f"episodes={list(config.episodes)}: options.csv has no episode {missing[0]}")
    return options.timeline(rows, chosen), {}


def _chain(config: FigureConfig, groups: Groups) -> Drawn:
    found = {}
    for label, runs in groups.items():
        # Episodes of several evaluations are told apart by which of them they belong to.
        pooled = (
            pd.concat(
                [frame.assign(episode=[(i, each) for each in frame["episode"]]) for i, frame in enumerate(frames)]
            )
            for frames in ([run.episodes for run in runs], [_options(run) for run in runs])
        )
        found[label] = chain_lengths(*pooled)
    return options.chain(found), dict(found)


def _controllers(config: FigureConfig, groups: Groups) -> Drawn:
    numbers = controllers.compare(groups)
    print(controllers.table(numbers), end="")
    return controllers.draw(numbers), numbers


def _divisions(config: FigureConfig, groups: Groups) -> Drawn:
    numbers = divisions.compare(groups)
    print(divisions.table(numbers), end="")
    return divisions.draw(numbers), numbers


KINDS: dict[str, Callable[[FigureConfig, Groups], Drawn]] = {
    "levels": _levels,
    "speed": _speed,
    "plane": _plane,
    "paths": _paths,
    "people": _people,
    "jump": _jump,
    "timeline": _timeline,
    "chain": _chain,
    "controllers": _controllers,
    "divisions": _divisions,
}
