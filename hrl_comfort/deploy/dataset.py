"""`hrl-comfort dataset`: episodes of a policy or a chain as a Minari data set."""

from __future__ import annotations

import json
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from rich.console import Console

from hrl_comfort import __version__
from hrl_comfort.config import ConfigError, EvaluateConfig
from hrl_comfort.evaluation.ledger import open_split
from hrl_comfort.evaluation.rollout import BATCH, at_each_level
from hrl_comfort.files.output import output_folder
from hrl_comfort.files.run_config import environment, save_config
from hrl_comfort.hierarchy.controllers import make_executor
from hrl_comfort.hierarchy.executor import execute
from hrl_comfort.humans import EvaluationSet
from hrl_comfort.progress import progress, success_of
from hrl_comfort.sim.processes.engine import make_engine
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.tasks import State

if TYPE_CHECKING:
    from minari.data_collector import EpisodeBuffer

NO_OPTION = -1
"""`infos["option"]` of the first row, before the first decision."""


def dataset(config: EvaluateConfig) -> Path:
    """Write the episodes of `config` as the Minari data set `hrl_comfort/TASK-v0` in `output`; return its folder.

    Observations are those of the task, actions in [-1, 1]. `infos` have a row more than actions, as observations do:
    row t tells of the decision that led to observation t.

    Raises:
      ConfigError: Minari is not installed, the output holds something, or a policy is missing or does not fit.
    """
    if config.regret:
        raise ConfigError("regret=true does not go with dataset, which has no column for it; leave it out")
    try:
        import minari
        from minari.dataset.minari_storage import MinariStorage
    except ImportError as error:
        raise ConfigError(f"dataset needs {error.name}: pip install 'hrl-comfort[dataset]'") from error
    import gymnasium

    identity = f"hrl_comfort/{config.task.name}-v0"
    output = Path(config.output)
    with output_folder(output, EvaluateConfig):
        episodes, options, widths = _episodes(config)
        folder = output / identity / "data"
        shutil.rmtree(folder, ignore_errors=True)  # of an earlier one, with --overwrite
        folder.mkdir(parents=True)
        boxes = [
            gymnasium.spaces.Box(-bound, bound, (width,), np.float32)
            for bound, width in zip((np.inf, 1), widths, strict=True)
        ]
        storage = MinariStorage.new(folder.resolve(), boxes[0], boxes[1], data_format="arrow")
        storage.update_metadata(
            {
                "dataset_id": identity,
                "minari_version": minari.__version__,
                "algorithm_name": config.policy or f"meta_controller={config.meta_controller.name}",
                "description": f"Task {config.task.name} of hrl-comfort; infos are described in its docs/export.md.",
                "requirements": [f"hrl-comfort=={__version__}"],
                "options": options,
                "environment": json.dumps(asdict(environment(config))),
            }
        )
        # Minari would measure the whole folder after every episode: a time that grows as the square of their number.
        vars(storage)["get_size"] = float
        storage.update_episodes(episodes)
        del vars(storage)["get_size"]
        storage.update_metadata({"dataset_size": storage.get_size()})
        save_config(config, output / "config.yaml")
    steps = sum(len(episode) for episode in episodes)
    Console().print(f"{folder.parent}: {len(episodes)} episodes, {steps:,} decisions", soft_wrap=True)
    return folder.parent


def _episodes(config: EvaluateConfig) -> tuple[list[EpisodeBuffer], list[str], tuple[int, int]]:
    """Return the episodes, the names of the options, and the widths of observations and actions."""
    look, total = open_split(config), config.episodes * max(1, len(config.levels))
    found: list[EpisodeBuffer] = []
    with progress(f"dataset {config.task.name}", total) as show:
        for at_level in at_each_level(config):
            for start in range(0, config.episodes, BATCH):
                part, options = _batch(at_level, look.entries.part(start, start + BATCH), len(found))
                found += part
                show(len(found), success_of([bool(each.infos["success"][-1]) for each in found if each.infos]))
    look.completed()
    return found, options, (found[0].observations.shape[1], found[0].actions.shape[1])  # type: ignore[union-attr]


def _batch(config: EvaluateConfig, entries: EvaluationSet, first: int) -> tuple[list[EpisodeBuffer], list[str]]:
    """Return the episodes `entries`, numbered from `first`, and the names of the options."""
    from minari.data_collector import EpisodeBuffer

    rows = len(entries.episode)
    engine = make_engine(environment(config), rows, 0, entries, disturbance=config.disturbance)
    executor, top = make_executor(config, None, engine, config.first_seed)

    def observe(state: State) -> torch.Tensor:
        return engine.episodes.subtask.observe(engine.episodes.observed(state))

    state = engine.reset()
    observations, rewards, terminated, given_up, actions, active = [observe(state)], [], [], [], [], []
    infos = [_infos(state, torch.full((rows,), NO_OPTION))]
    for executed in execute(engine, executor, top):
        result = executed.result
        observations[-1] = observe(result.before)  # an option may have aimed at another object since
        observations.append(observe(result.state))
        actions.append(executed.action)
        rewards.append(result.reward)
        terminated.append(result.terminated)
        given_up.append(executed.ended & ~result.terminated)
        active.append(executed.active)
        infos.append(_infos(result.state.with_(level=result.level), executed.option, result))
    engine.close()
    # Decisions of each row; in others it waits, where the top decides for all cells together, or has ended.
    decisions = [torch.nonzero(own).squeeze(-1).tolist() for own in torch.stack(active, dim=1)]

    def of(series: list[torch.Tensor], row: int, at: list[int]) -> Any:
        values = torch.stack([series[index][row] for index in at]).numpy()
        return values.astype(np.float32) if values.dtype == np.float64 else values

    return [
        EpisodeBuffer(
            id=first + row,
            seed=int(entries.episode_seed[row]),
            observations=of(observations, row, [*at, at[-1] + 1]),
            actions=of(actions, row, at),
            rewards=of(rewards, row, at),
            terminations=of(terminated, row, at),
            truncations=of(given_up, row, at),
            # As lists, for Minari does not read arrays of one number a row.
            infos={
                name: of([each[name] for each in infos], row, [0, *(index + 1 for index in at)]).tolist()
                for name in infos[0]
            },
        )
        for row, at in enumerate(decisions)
    ], executor.table.names


def _infos(state: State, option: torch.Tensor, result: StepResult | None = None) -> dict[str, torch.Tensor]:
    """Return the infos (N,) of a decision that led to `state`, or of the start of episodes."""
    none = torch.zeros_like(state.contact)
    held: dict[str, torch.Tensor] = {
        name: getattr(state, name) for name in ("drops", "object_lost") if name in state.fields()
    }
    return {
        "comfort_level": state.level,
        "stage": state.stage,
        "option": option,
        "contact": none if result is None else state.contact,
        "unsafe_contact": none if result is None else state.unsafe_contact,
        "success": none if result is None else result.success,
        "control_steps": torch.zeros_like(state.steps) if result is None else result.decision_steps,
        **held,
    }
