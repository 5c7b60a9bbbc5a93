"""`hrl-comfort train hierarchy`: train the options of a cycle, in order or at a time, evaluate them and the cycle.

Every part leaves a file by which a later call knows that it is done, so the same command goes on where it stopped.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from hrl_comfort.analysis.tables import of_groups
from hrl_comfort.composition.stages import stages_of, train_config, with_budget
from hrl_comfort.config import (
    HIERARCHY,
    RANDOM,
    ConfigError,
    EnvConfig,
    EvaluateConfig,
    HierarchyTrainConfig,
    MetaControllerConfig,
    MetaControllerTrainConfig,
    TrainConfig,
)
from hrl_comfort.config.hierarchy import OPTION_KEYS
from hrl_comfort.config.learning import SKILL_LEARNERS
from hrl_comfort.evaluation.evaluate import evaluate
from hrl_comfort.evaluation.terminal_states import NoSuccess, record_terminal_states
from hrl_comfort.files.documents import Summary, read_json
from hrl_comfort.files.provenance import RunState, is_finished, read_provenance, run_state, write_provenance
from hrl_comfort.files.run_config import environment, is_same, load_config, save_config
from hrl_comfort.tasks import subtask
from hrl_comfort.training.controller_trainer import train_meta_controller
from hrl_comfort.training.parallel import run_each
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
        begin, finished = time.monotonic() - _seconds(folder), False
        try:
            options = train_options(config, folder)
            if (controller := controller_config(config, folder)) is not None:
                _train(controller)
            left = [each for each in evaluations(config, folder, options) if not _evaluated(each)]
            run_each(evaluate, left, config.hierarchy.jobs)
            finished = True
        except Preempted as stopped:
            raise Preempted(f"stopped by SIGTERM; go on with train hierarchy resume={folder}") from stopped
        finally:
            write_provenance(folder, config, finished, time.monotonic() - begin)
    return folder


def _seconds(folder: Path) -> float:
    """Return for how long what is in the folder has been trained before, s."""
    return read_provenance(folder).wall_seconds if (folder / "provenance.json").is_file() else 0.0


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
    if config.hierarchy.refinement and config.agent.name not in SKILL_LEARNERS:
        raise ConfigError(
            f"hierarchy.refinement goes on from networks that agent.name={config.agent.name} does not keep; choose one "
            f"of {', '.join(SKILL_LEARNERS)}, or hierarchy.refinement=[]"
        )
    several = len(config.meta_controller.options) > 1
    if several and config.hierarchy.starts == "recorded" and config.task.object != RANDOM:
        raise ConfigError(
            f"task.object={config.task.object}: recorded starts need every kind; choose {RANDOM}, or "
            "hierarchy.starts=ik"
        )
    options = {name: option_config(config, name, folder / name, "ik") for name in config.meta_controller.options}
    for name, option in options.items():
        stages_of(option)
        if config.hierarchy.refinement:
            stages_of(refined_config(config, option, folder / f"{name}_first", None), "hierarchy.refinement")
    evaluations(config, folder, options.values())


def train_options(config: HierarchyTrainConfig, folder: Path) -> list[TrainConfig]:
    """Train every option, as `hierarchy.starts` says, then refine them from the last to the first.

    Return the configurations of their runs.
    """
    names, refined = list(config.meta_controller.options), bool(config.hierarchy.refinement)
    folders = [folder / (f"{name}_first" if refined else name) for name in names]
    if config.hierarchy.starts == "ik":
        options = [option_config(config, *each, "ik") for each in zip(names, folders, strict=True)]
        run_each(_train, sorted(options, key=lambda each: -each.agent.policy_steps), config.hierarchy.jobs)
    else:
        options = _trained_in_order(config, names, folders)
    following: Path | None = None
    if not refined:
        return options
    again: list[TrainConfig] = []
    for name, first in zip(reversed(names), reversed(options), strict=True):
        again.append(refined_config(config, replace(first, output=str(folder / name)), Path(first.output), following))
        _train(again[-1])
        following = folder / name
    return again[::-1]


def _trained_in_order(config: HierarchyTrainConfig, names: list[str], folders: list[Path]) -> list[TrainConfig]:
    """Train options, each from the terminal states of the one before; return the configurations of their runs."""
    options, start = list[TrainConfig](), "ik"
    for name, folder in zip(names, folders, strict=True):
        options.append(option_config(config, name, folder, start))
        _train(options[-1])
        if name != names[-1]:
            start = terminal_states_of(options[-1], config)
    return options


def option_config(config: HierarchyTrainConfig, name: str, folder: Path, start: str) -> TrainConfig:
    """Return the configuration of an option's training in `folder` from `start`."""
    length = config.task.max_episode_steps * EPISODE_LENGTH.get(name, 1)
    task = replace(config.task, name=name, start=start, max_episode_steps=length)
    own = train_config(config, task=task, output=str(folder), resume=None)
    return with_budget(own, max(1, round(config.agent.policy_steps * config.hierarchy.budget_fractions[name])))


def refined_config(
    config: HierarchyTrainConfig, option: TrainConfig, first: Path, following: Path | None
) -> TrainConfig:
    """Return the configuration of an option's second training, from the policy of its `first`."""
    stages = config.hierarchy.refinement
    budget = sum(stage.policy_steps for stage in stages)
    agent = replace(option.agent, policy_steps=budget, next_skill=None if following is None else str(following))
    curriculum = replace(option.curriculum, stages=stages)
    again = replace(option, agent=agent, curriculum=curriculum, initial_policy=str(first))
    return with_budget(again, max(len(stages), round(budget * config.hierarchy.budget_fractions[option.task.name])))


def controller_config(config: HierarchyTrainConfig, folder: Path) -> MetaControllerTrainConfig | None:
    """Return the configuration of the training of a meta-controller above the options, if there is one."""
    controller = config.hierarchy.controller
    if controller is None:
        return None
    policies = {name: str(folder / name) for name in config.meta_controller.options}
    return replace(
        controller, policies=policies, train_seed=config.train_seed, episode_seed=config.episode_seed,
        output=str(folder / controller.output),
    )  # fmt: skip


def _train(config: TrainConfig | MetaControllerTrainConfig) -> None:
    """Train in the folder that `config` names, unless that is done; go on where it was stopped."""
    state = run_state(Path(config.output))
    if state is RunState.STOPPED:
        config = replace(config, resume=config.output)
    if state is not RunState.FINISHED:
        train(config) if isinstance(config, TrainConfig) else train_meta_controller(config)


def terminal_states_of(option: TrainConfig, config: HierarchyTrainConfig) -> str:
    """Return the file of an option's recorded terminal states; `ik`, with a warning, where no episode succeeds."""
    path = Path(option.output) / "terminal_states.npz"
    asked = _evaluation(
        option, config.meta_controller.alone(), Path(option.output), policy=option.output,
        episodes=config.hierarchy.terminal_states_episodes, terminal_states=str(path),
    )  # fmt: skip
    try:
        if not path.is_file():
            record_terminal_states(asked)
    except NoSuccess as error:
        Console(stderr=True).print(f"{error}; the next option starts from inverse kinematics", soft_wrap=True)
        return "ik"
    return str(path)


def evaluations(config: HierarchyTrainConfig, folder: Path, options: Iterable[TrainConfig]) -> list[EvaluateConfig]:
    """Return the evaluations of every option, of their chain in `cycle`, and of the controller beside a simple rule.

    Beside people whose splits are kept apart the episodes are those of `validation`, else the paper's.
    """
    common: dict[str, Any] = {
        "episodes": config.hierarchy.episodes, "record": True, "group_by": ["seen"], "split": _split(config),
    }  # fmt: skip
    at_levels: dict[str, Any] = {**common, "levels": config.hierarchy.levels}
    parts = {option.task.name: option for option in options}
    policies = {name: option.output for name, option in parts.items()}
    found = [
        _evaluation(option, config.meta_controller.alone(), folder / name, policy=option.output, **at_levels)
        for name, option in parts.items()
    ]
    if "cycle" not in parts:
        steps = config.task.max_episode_steps * EPISODE_LENGTH["cycle"]
        cycle = replace(environment(config), task=replace(config.task, name="cycle", max_episode_steps=steps))
        found.append(_evaluation(cycle, config.meta_controller, folder / "cycle", policies, **at_levels))
    if (controller := controller_config(config, folder)) is not None:
        task, learned, rule = controller.task.name, controller.meta_controller, controller.meta_controller_agent.rule
        asked = at_levels if controller.comfort.source == "random" else common
        asked = {**asked, "split": _split(controller), "record": not subtask(task).repeats}  # paths of shifts are long
        simple = replace(learned, name=rule or "nearest", **OPTION_KEYS)
        found.append(_evaluation(controller, simple, folder / f"{task}_{simple.name}", policies, **asked))
        policies = {**policies, "meta_controller": controller.output}
        found.append(_evaluation(controller, learned, folder / f"{task}_learned", policies, **asked))
    return found


def _split(env: EnvConfig) -> str:
    return "validation" if env.human.partitioned else "paper"


def _evaluated(evaluation: EvaluateConfig) -> bool:
    return (Path(evaluation.output) / "summary.json").is_file()


def _evaluation(
    env: EnvConfig,
    meta_controller: MetaControllerConfig,
    folder: Path,
    policies: dict[str, str] | None = None,
    **asked: Any,
) -> EvaluateConfig:
    """Return an evaluation in `env` that goes to eval/ in `folder`: `asked`, and else that of no choices."""
    sections: dict[str, Any] = vars(environment(env))
    plain: dict[str, Any] = {
        "policy": None, "checkpoints": "none", "split": "paper", "episode_seed": None, "levels": [], "group_by": [],
        "record": False, "realtime": False, "disturbance": "none", "terminal_states": None, "regret": False,
    }  # fmt: skip
    own = {**plain, **asked, "policies": policies or {}, "output": str(folder / "eval")}
    return EvaluateConfig(**sections, meta_controller=meta_controller, **own)


def print_table(folder: Path) -> None:
    """Print the evaluations in a hierarchy's folder."""
    files = sorted(folder.glob("*/eval/summary.json"))
    of_file = {file.parent.parent.name: read_json(file, Summary).model_dump()["groups"] for file in files}
    print(folder)
    Console().print(of_groups([{**group, "task": name} for name, groups in of_file.items() for group in groups]))
