"""`hrl-comfort train hierarchy`: train the options of a cycle in order, evaluate them and the cycle.

Every part leaves a file by which a later call knows that it is done, so the same command goes on where it stopped.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from hrl_comfort.analysis.tables import of_groups
from hrl_comfort.config import (
    HIERARCHY,
    ConfigError,
    EvaluateConfig,
    HierarchyTrainConfig,
    MetaControllerTrainConfig,
    TrainConfig,
)
from hrl_comfort.config.compose import compose, is_same, load_config, save_config
from hrl_comfort.config.overrides import override
from hrl_comfort.config.stages import stages_of, train_config, with_budget
from hrl_comfort.evaluation.evaluate import evaluate
from hrl_comfort.evaluation.terminal_states import record_terminal_states
from hrl_comfort.files.documents import Summary, read_json
from hrl_comfort.files.provenance import is_finished, write_provenance
from hrl_comfort.training.controller_trainer import train_meta_controller
from hrl_comfort.training.left import Left, left
from hrl_comfort.training.preemption import Preempted
from hrl_comfort.training.resume import claim
from hrl_comfort.training.trainer import train

EPISODE_LENGTH = {"cycle": 3}
"""`task.max_episode_steps` of an option, as a multiple of the hierarchy's; 1 where it is not named."""


def train_hierarchy(config: HierarchyTrainConfig) -> Path:
    """Train as `config` says, or go on with it; return the folder.

    Raises:
        ConfigError: a choice is not allowed, or the folder holds another training.
        Preempted: SIGTERM came during a training; a checkpoint has been written.
    """
    folder = Path(config.resume or config.output)
    config = _config_in(folder, config)
    if is_finished(folder):
        print(f"{folder} is finished")
        return folder
    _check(config, folder)
    with claim(folder, resume=(folder / HIERARCHY).is_file()):
        save_config(config, folder / HIERARCHY)
        begin = time.monotonic()
        try:
            policies = train_options(config, folder)
            if config.hierarchy.controller:
                policies["meta_controller"] = train_controller(config, folder, policies)
        except Preempted as stopped:
            raise Preempted(f"stopped by SIGTERM; go on with train hierarchy resume={folder}") from stopped
        evaluate_all(config, folder, policies)
        write_provenance(folder, config, finished=True, seconds=time.monotonic() - begin)
    return folder


def _config_in(folder: Path, asked: HierarchyTrainConfig) -> HierarchyTrainConfig:
    """Return the configuration in force in `folder`: the one there, or `asked`."""
    if not (folder / HIERARCHY).is_file():
        if asked.resume is not None:
            raise ConfigError(f"resume={folder} is not the folder of a hierarchy: it has no {HIERARCHY}")
        return asked
    there = load_config(folder / HIERARCHY)
    assert isinstance(there, HierarchyTrainConfig)
    if asked.resume is None and not is_same(there, asked):
        raise ConfigError(f"output={folder} already holds another hierarchy; choose another, or say resume={folder}")
    return there


def _check(config: HierarchyTrainConfig, folder: Path) -> None:
    """Raise ConfigError at a choice that a later part would refuse."""
    for name in config.meta_controller.options:
        stages_of(option_config(config, name, folder, "ik"))
        if config.hierarchy.refinement:
            stages_of(refined_config(config, name, folder, "ik", folder, None), "hierarchy.refinement")
    compose("train_meta_controller", config.hierarchy.controller)


def train_options(config: HierarchyTrainConfig, folder: Path) -> dict[str, Path]:
    """Train every option, then refine them from the last to the first; return their run folders."""
    options, refined = list(config.meta_controller.options), bool(config.hierarchy.refinement)
    first = {name: folder / (f"{name}_first" if refined else name) for name in options}
    starts, start = {}, "ik"
    for name in options:
        starts[name] = start
        _train(option_config(config, name, first[name], start))
        if name != options[-1]:
            start = terminal_states_of(first[name], config.hierarchy.terminal_states_episodes)
    final = {name: folder / name for name in options}
    following = None
    for name in reversed(options) if refined else ():
        _train(refined_config(config, name, final[name], starts[name], first[name], following))
        following = final[name]
    return final


def option_config(config: HierarchyTrainConfig, name: str, folder: Path, start: str) -> TrainConfig:
    """Return the configuration of an option's training in `folder` from `start`."""
    length = config.task.max_episode_steps * EPISODE_LENGTH.get(name, 1)
    task = replace(config.task, name=name, start=start, max_episode_steps=length)
    own = train_config(config, task=task, output=str(folder), resume=None)
    return with_budget(own, max(1, round(config.agent.policy_steps * config.hierarchy.shares[name])))


def refined_config(
    config: HierarchyTrainConfig, name: str, folder: Path, start: str, first: Path, following: Path | None
) -> TrainConfig:
    """Return the configuration of an option's second training, from the policy of `first`."""
    own = option_config(config, name, folder, start)
    stages = config.hierarchy.refinement
    budget = sum(stage.policy_steps for stage in stages)
    agent = replace(own.agent, policy_steps=budget, next_skill=None if following is None else str(following))
    curriculum = replace(own.curriculum, stages=stages)
    again = replace(own, agent=agent, curriculum=curriculum, initial_policy=str(first))
    return with_budget(again, max(len(stages), round(budget * config.hierarchy.shares[name])))


def _train(config: TrainConfig) -> None:
    """Train in the folder that `config` names, unless that is done; go on where it was stopped."""
    rest = left(Path(config.output))
    if rest is not Left.NOTHING:
        train(replace(config, resume=config.output) if rest is Left.REST else config)


def terminal_states_of(folder: Path, episodes: int) -> str:
    """Return the file of a run's recorded terminal states; `ik`, with a warning, where no episode succeeds."""
    path = folder / "terminal_states.npz"
    words = [override("policy", folder), f"episodes={episodes}", override("terminal_states", path)]
    try:
        if not path.is_file():
            record_terminal_states(_evaluation(words))
    except ConfigError as error:
        Console(stderr=True).print(f"{error}; the next option starts from inverse kinematics", soft_wrap=True)
        return "ik"
    return str(path)


def train_controller(config: HierarchyTrainConfig, folder: Path, policies: dict[str, Path]) -> Path:
    """Train a meta-controller of `sort` above the options; return its folder."""
    output = folder / "controller"
    rest = left(output)
    if rest is Left.NOTHING:
        return output
    seeds = [f"train_seed={config.train_seed}", f"episode_seed={config.episode_seed}"]
    words = [*config.hierarchy.controller, *_policies(policies), *seeds, override("output", output)]
    own = compose("train_meta_controller", words)
    assert isinstance(own, MetaControllerTrainConfig)
    return train_meta_controller(replace(own, resume=str(output)) if rest is Left.REST else own)


def evaluate_all(config: HierarchyTrainConfig, folder: Path, policies: dict[str, Path]) -> None:
    """Evaluate every option, their chain in `cycle`, and the controllers of `sort` in `sort`.

    Beside people whose splits are kept apart the episodes are those of `validation`, else the paper's.
    """
    options = {name: path for name, path in policies.items() if name != "meta_controller"}
    split = "validation" if config.human.partitioned else "paper"
    common = [f"episodes={config.hierarchy.episodes}", "record=true", "group_by=[seen]", f"split={split}"]
    levels = [override("levels", config.hierarchy.levels)]
    for path in options.values():
        _evaluate([override("policy", path), *common, *levels], path / "eval")
    division = [override("meta_controller.options", list(options))]
    if "cycle" not in options:
        chain = ["task=cycle", "meta_controller=scripted", *division, *_policies(options)]
        _evaluate([*chain, *common, *levels], folder / "cycle" / "eval")
    if "meta_controller" in policies:
        own = {line: line.split("=")[0] for line in config.hierarchy.controller}
        world = [line for line, key in own.items() if key.split(".")[0] in ("human", "task", "comfort")]
        told = [line for line, key in own.items() if key.startswith("meta_controller.")]
        sort = ["task=sort", "comfort=sort", "reward=sort", *world, *_policies(options), *common]
        _evaluate([*sort, "meta_controller=scripted"], folder / "sort_scripted" / "eval")
        learned = override("policies.meta_controller", policies["meta_controller"])
        _evaluate([*sort, "meta_controller=learned", *told, learned], folder / "sort_learned" / "eval")


def _policies(policies: dict[str, Path]) -> list[str]:
    return [override(f"policies.{name}", path) for name, path in policies.items()]


def _evaluation(words: list[str]) -> EvaluateConfig:
    config = compose("evaluate", words)
    assert isinstance(config, EvaluateConfig)
    return config


def _evaluate(words: list[str], output: Path) -> None:
    """Evaluate into `output`, unless that is done."""
    if not (output / "summary.json").is_file():
        evaluate(_evaluation([*words, override("output", output)]))


def print_table(folder: Path) -> None:
    """Print the evaluations in a hierarchy's folder."""
    files = sorted(folder.glob("*/eval/summary.json"))
    of_file = {file.parent.parent.name: read_json(file, Summary).model_dump()["groups"] for file in files}
    print(folder)
    Console().print(of_groups([{**group, "task": name} for name, groups in of_file.items() for group in groups]))
