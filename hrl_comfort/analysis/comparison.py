"""Groups of evaluations side by side: controllers by their return, divisions of a task by result and training cost.

Differences are those of the first group from each other one, over the same episodes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pandas import DataFrame

from hrl_comfort.analysis.intervals import SHARE, Clusters
from hrl_comfort.analysis.tables import Quantity, of_means
from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.config.hydra_conf import run_folder
from hrl_comfort.files.provenance import read_provenance
from hrl_comfort.files.run_config import load_config
from hrl_comfort.files.run_folder import Run
from hrl_comfort.files.tables import column

PARTS = ("success", "return", "placed", "time", "discomfort")
"""Success and return of a controller, and the parts of its return: placed objects, costs of time and discomfort."""
RESULTS = ("success", "contact", "steps", "distance")
"""Results of a division; steps and mean distance to the person of episodes that succeed."""
QUANTITIES = {
    "networks": Quantity("networks", digits=0),
    "policy_steps": Quantity("policy steps", digits=0),
    "minutes": Quantity("training, min", digits=0),
    "success": Quantity("success, %", 100, 1, SHARE),
    "contact": Quantity("contact, %", 100, 1, SHARE),
    "steps": Quantity("steps", digits=1),
    "distance": Quantity("distance, m"),
    "return": Quantity("return"),
    "placed": Quantity("objects placed"),
    "time": Quantity("cost of time"),
    "discomfort": Quantity("cost of discomfort"),
}
SAME = ("robot", "cell", "human", "safety", "randomise", "comfort", "task", "reward", "disturbance")
"""Sections of the configuration in which evaluations must agree to be compared."""
EPISODE = ["train_seed", "episode", "spawn_id"]
"""Columns that tell which episode of which training seed a row is of."""
REWARDED = ("place", "step", "k1", "k2", "k3")
"""Weights of the reward that may differ from zero: of objects, time and discomfort."""
Groups = Mapping[str, Sequence[Run]]
Numbers = dict[str, dict[str, Any]]


def controllers(groups: Groups) -> dict[str, Numbers]:
    """Return the means of every controller's PARTS, and the first one's differences from the others.

    Each evaluation of the first one is compared with the one of another controller that has the same skills, so that
    several trained controllers may stand beside one that learns nothing. Where the first one was run with several sets
    of skills, its intervals, and those of the differences, are over these sets: controllers of one set are not
    independent. With one set they are over its training seeds, and speak of these skills. Those of the others are over
    the training seeds of their first skill.

    Raises:
      ConfigError: an evaluation has several levels, another reward or no `objects_placed`; two of the first controller
        are of one training seed and the same skills; or two did not run the same episodes in the same way.
    """
    for run in (run for runs in groups.values() for run in runs):
        if (wrong := _unfit(run)) is not None:
            raise ConfigError(f"{run.folder}: {wrong}; kind=controllers takes one level with reward=sort")
    first, *others = groups
    seeds = _independent(first, groups[first])
    frames = {first: _earnings(groups[first], seeds), **{label: _earnings(groups[label]) for label in others}}
    beside = {label: _earnings(_with_same_skills(groups, first, label), seeds) for label in others}
    means, differences = _compare(groups, frames, PARTS, beside)
    return {"controllers": means, "differences": differences}


def _independent(label: str, runs: Sequence[Run]) -> list[int | None]:
    """Return for each evaluation the number of its set of skills or, if all have the same, its training seed."""
    sets: list[dict[str, str]] = []
    told: dict[tuple[int, int | None], Run] = {}
    for run in runs:
        if _skills(run) not in sets:
            sets.append(_skills(run))
        key = sets.index(_skills(run)), _seed(run)
        if key in told:
            raise ConfigError(
                f"labels={label}: {told[key].folder} and {run.folder} both have train_seed={key[1]} and the same "
                "skills; give one of each training seed"
            )
        told[key] = run
    return [which if len(sets) > 1 else seed for which, seed in told]


def _with_same_skills(groups: Groups, first: str, label: str) -> list[Run]:
    """Return for each evaluation of `first` the one of `label` that has the same skills."""
    found = []
    for mine in groups[first]:
        same = [run for run in groups[label] if _skills(run) == _skills(mine)]
        same = [run for run in same if _seed(run) == _seed(mine)] or same
        if len(same) != 1:
            raise ConfigError(
                f"labels=[{first},{label}]: {len(same)} evaluations of {label} have the skills of {mine.folder}; give "
                "one, and put trained controllers first"
            )
        found += same
    return found


def _seed(run: Run) -> int | None:
    """Return the training seed of an evaluation, None where nothing was trained."""
    seed = _episodes(run)["train_seed"].iloc[0]
    return None if pd.isna(seed) else int(seed)


def _episodes(run: Run) -> DataFrame:
    """Return the episodes of an evaluation that is not `_unfit`."""
    assert run.episodes is not None, "_unfit"
    return run.episodes


def _earnings(runs: Sequence[Run], seeds: Sequence[int | None] | None = None) -> DataFrame:
    """Return the episodes of evaluations and, in the columns PARTS, the parts of their return.

    `seeds` stand in the place of the evaluations' training seeds, if given.
    """
    frame, reward = _pooled(runs), runs[0].config["reward"]
    if seeds is not None:
        counts = [len(_episodes(run)) for run in runs]
        frame["train_seed"] = pd.array(np.repeat(np.array(seeds, dtype=object), counts), dtype="Int64")
    placed, time = reward["place"] * column(frame, "objects_placed"), -reward["step"] * column(frame, "steps")
    return frame.assign(placed=placed, time=time, discomfort=placed - time - column(frame, "return"))


def _unfit(run: Run) -> str | None:
    """Return why the parts of an evaluation's return cannot be told, None where they can."""
    reward = run.config.get("reward")
    if not reward:
        return "no reward in its config.yaml"
    if run.config.get("levels"):
        return "several comfort levels"
    if run.episodes is None or run.episodes.empty or np.isnan(column(run.episodes, "objects_placed")).any():
        return "no objects_placed in its episodes.csv"
    missing = [name for name in EPISODE if name not in run.episodes]
    if missing:
        return f"no {missing[0]} in its episodes.csv"
    other = (f"reward.{name}={weight}" for name, weight in reward.items() if weight and name not in REWARDED)
    return next(other, None)


def _skills(run: Run) -> dict[str, str]:
    return {name: policy for name, policy in (run.config.get("policies") or {}).items() if name != "meta_controller"}


def divisions(groups: Groups) -> dict[str, Numbers]:
    """Return every division's means of RESULTS, its training cost, and how the first differs from the others.

    Differences of steps and distance are over episodes where both succeed. The cost is the mean over training seeds.

    Raises:
      ConfigError: as `training_cost`, or the divisions did not run the same episodes in the same way.
    """
    frames = {}
    for label, runs in groups.items():
        frame = _pooled(runs)
        won = column(frame, "success") > 0
        frames[label] = frame.assign(
            contact=column(frame, "contact"),
            steps=np.where(won, column(frame, "steps"), np.nan),
            distance=np.where(won, column(frame, "human_distance_mean_m"), np.nan),
        )
    means, differences = _compare(groups, frames, RESULTS, dict(list(frames.items())[1:]))
    for label, runs in groups.items():
        means[label] |= DataFrame([training_cost(run) for run in runs]).mean().to_dict()
    return {"divisions": means, "differences": differences}


def training_cost(run: Run) -> dict[str, float]:
    """Return how many policies an evaluation chains and what their training took: policy steps and minutes.

    A policy that another was begun from (`initial_policy`) counts too, once.

    Raises:
      ConfigError: a policy was not trained to its end, or its folder is not there.
    """
    policies = list((run.config.get("policies") or {}).values()) or [run.config.get("policy")]
    spent: dict[Path, tuple[int, float]] = {}
    left = list(policies)
    while left:
        policy = left.pop()
        folder = run_folder(policy) if policy else None
        if folder is None:
            raise ConfigError(f"{run.folder}: policy={policy!r} is not a run folder, so its training cost is unknown")
        config, provenance = load_config(folder), read_provenance(folder)
        if not isinstance(config, TrainConfig) or not provenance.finished:
            raise ConfigError(f"{folder} is not finished, or no training, so its training cost is unknown")
        spent[folder.resolve()] = provenance.policy_steps, provenance.wall_seconds / 60
        left += begun_from(config)
    policy_steps, minutes = map(sum, zip(*spent.values(), strict=True))
    return {"networks": len(policies), "policy_steps": policy_steps, "minutes": minutes}


def begun_from(config: TrainConfig) -> list[str]:
    """Return the policies that a training began from: one, one for each skill of a chain, or none."""
    if config.initial_policy is None:
        return []
    if config.agent.name == "end_to_end":
        return [str(Path(config.initial_policy) / name) for name in config.agent.own["skills"]]
    return [config.initial_policy]


def _pooled(runs: Sequence[Run]) -> DataFrame:
    """Return the episodes of several evaluations, one table."""
    frame = pd.concat([run.episodes for run in runs if run.episodes is not None], ignore_index=True)
    return frame.assign(success=column(frame, "success"))


def _world(run: Run, section: str) -> Any:
    """Return a section of an evaluation's configuration without `task.observation`, which each policy brings along."""
    found = run.config.get(section)
    if section != "task" or found is None:
        return found
    return {key: value for key, value in found.items() if key != "observation"}


def _compare(
    groups: Groups, frames: Mapping[str, DataFrame], names: Sequence[str], beside: Mapping[str, DataFrame]
) -> tuple[Numbers, Numbers]:
    """Return the means of columns of each group's episodes, and how the first one differs from those `beside` it."""
    one, *others = [run for runs in groups.values() for run in runs]
    for run in others:
        for section in SAME:
            if _world(one, section) != _world(run, section):
                raise ConfigError(f"{one.folder} and {run.folder} differ in {section}; compare like with like")
    means: Numbers = {}
    differences: Numbers = {}
    first, own = next(iter(frames.items()))
    for label, frame in frames.items():
        bounds = {name: QUANTITIES[name].bounds for name in names}
        means[label] = {"episodes": len(frame), **Clusters.of(frame).estimates(frame[[*names]], bounds)}
    for label, frame in beside.items():
        if not own[EPISODE].equals(frame[EPISODE]):
            raise ConfigError(f"labels={[first, label]}: both must have run the same episodes with the same seeds")
        differences[f"{first} - {label}"] = {**Clusters.of(own).estimates(own[[*names]] - frame[[*names]])}
    return means, differences


def table(numbers: Mapping[str, Numbers]) -> str:
    """Return the result of `controllers` or `divisions` as a Markdown table: the groups, then the differences."""
    rows = {label: means for section in numbers.values() for label, means in section.items()}
    return of_means(rows, QUANTITIES)
