"""Handover diagnostics: success of a subtask from the terminal states of the one before.

Skills that succeed alone can fail in a chain, because the policy before leaves the arm in states that the
next one was not trained from. Three tables: success of each subtask by kind of start, how many options
chains complete, and observations at the handover that were rare in training.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
from rich.console import Console

from hrl_comfort.analysis.episodes import chain_lengths, success
from hrl_comfort.analysis.tables import cell
from hrl_comfort.config import TERMINAL_STATES_SEED, ConfigError, EvaluateConfig, MetaControllerConfig
from hrl_comfort.evaluation.ledger import open_split
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.evaluation.terminal_states import record_terminal_states
from hrl_comfort.files.atomic import all_or_none
from hrl_comfort.files.output import EVALUATION_MARKS, output_folder
from hrl_comfort.files.run_config import environment, save_config, trained_environment
from hrl_comfort.files.tables import records_of, write_table
from hrl_comfort.hierarchy.controllers import check_given
from hrl_comfort.policies.actor import ActorPolicy, load_policy
from hrl_comfort.policies.load import observed_by
from hrl_comfort.sim.processes.engine import make_engine
from hrl_comfort.tasks import subtask

RECORDED_EPISODES = 2000
"""Episodes, drawn as in training, of which terminal states are recorded."""
FIRST_SEED = TERMINAL_STATES_SEED + 10_000
"""First of their seeds, above those of terminal states that skills train from."""
FAR = 3.0
"""Standard deviations from the mean in training beyond which an observation counts as far."""
LONE = MetaControllerConfig(
    name="none", options=[], time_limit_steps=1, interruption_steps=None, retries=0, max_waits=None, level_override=[],
    further_options=[], order=[],
)  # fmt: skip


def handover(config: EvaluateConfig) -> Path:
    """Write handover.csv, its handover_episodes.csv, chain.csv and seams.csv; return their folder.

    Raises:
      ConfigError: `config` names no chain of trained policies.
    """
    torch.set_num_threads(1)
    names = list(config.meta_controller.options)
    if config.meta_controller.name != "nearest" or len(names) < 2:
        raise ConfigError(
            f"meta_controller={config.meta_controller.name} chains nothing: "
            "give meta_controller=nearest task=cycle policies.*"
        )
    check_given(config)
    for name in names:
        if not Path(config.policies[name]).exists():
            raise ConfigError(f"policies.{name}={config.policies[name]} is no run folder: it has no own starts")
        if not isinstance(load_policy(config.policies[name]), ActorPolicy):
            raise ConfigError(
                f"policies.{name}={config.policies[name]} has no normaliser to tell what is far from its training"
            )
    if config.regret:
        raise ConfigError("regret=true does not go with handover, whose options have no alternative; leave it out")
    if config.levels:
        raise ConfigError(f"levels={list(config.levels)} does not go with handover; choose comfort.level=")
    if config.disturbance != "none":
        raise ConfigError(f"disturbance={config.disturbance} does not go with handover")
    output = Path(config.output)
    with output_folder(output, EvaluateConfig, *EVALUATION_MARKS):
        _write_tables(config, output)
    return output


def _write_tables(config: EvaluateConfig, output: Path) -> None:
    names = list(config.meta_controller.options)
    matrix: list[list[Any]] = []
    single: list[list[Any]] = []
    far_rows: list[list[Any]] = []
    upstream = dict.fromkeys(("previous", "expert"), "ik")
    for before, after in pairwise(names):
        upstream = {
            kind: _terminal_states(config, output, before, kind, upstream[kind]) for kind in ("previous", "expert")
        }
        for kind, start in {"own": own_start(config, after), **upstream}.items():
            part = alone(config, after, start, config.policies[after])
            ran = rollout(part)
            single += [[after, kind, each.episode, each.spawn_id, each.success] for each in ran.episodes]
            share = success(ran.table)
            matrix.append([after, kind, len(ran.episodes), share["mean"], *(share["ci95"] or (None, None))])
            told = f"{after} from {kind} starts: {cell(share, 100)} % of {len(ran.episodes)}"
            Console().print(told, soft_wrap=True)
            far_rows += [[after, kind, *row] for row in far_observations(part)]
    whole = rollout(config)
    far = chain_lengths(whole.table, records_of(whole.options, "options"), len(names))
    chain = ([at["options"], at["success"], *(at["ci95"] or (None, None))] for at in far)
    with all_or_none():
        save_config(config, output / "handover.yaml")
        write_table(output / "handover.csv", HANDOVER, matrix)
        write_table(output / "handover_episodes.csv", SINGLE, single)
        write_table(output / "seams.csv", FAR_OBSERVATIONS, far_rows)
        write_table(output / "chain.csv", CHAIN, chain)


HANDOVER = ["subtask", "start", "episodes", "success", "success_low", "success_high"]
SINGLE = ["subtask", "start", "episode", "spawn_id", "success"]
CHAIN = ["options", "success", "success_low", "success_high"]
FAR_OBSERVATIONS = ["subtask", "start", "observation", "component", "largest_deviation", "share_far"]


def alone(config: EvaluateConfig, name: str, start: str, policy: str) -> EvaluateConfig:
    """Return the evaluation of one subtask alone, from the starts `start` (`task.start`)."""
    task = replace(config.task, name=name, start=start, max_episode_steps=config.meta_controller.time_limit_steps)
    return replace(config, task=task, meta_controller=LONE, policies={}, policy=policy)


def own_start(config: EvaluateConfig, name: str) -> str:
    """Return the `task.start` from which the policy of a subtask was trained."""
    trained = trained_environment(config.policies[name])
    return "ik" if trained is None else trained.task.start


def _terminal_states(config: EvaluateConfig, output: Path, name: str, kind: str, start: str) -> str:
    """Record the terminal states of a subtask's policy, or of the expert; return the .npz."""
    path = str(output / f"{name}_{kind}.npz")
    part = alone(config, name, start, config.policies[name] if kind == "previous" else "expert")
    record_terminal_states(replace(part, terminal_states=path, episodes=RECORDED_EPISODES, split="train"), FIRST_SEED)
    return path


def far_observations(config: EvaluateConfig) -> list[list[Any]]:
    """Return name, component, largest deviation (standard deviations) and share far of each observation.

    Deviations are from the mean in training, over the first instants of the evaluation's episodes.
    """
    assert config.policy is not None
    policy = load_policy(config.policy)
    assert isinstance(policy, ActorPolicy)
    task = observed_by(
        policy, config.policy, subtask(config.task.name, hand=config.robot.gripper.holds), environment(config)
    )
    look = open_split(config)
    entries = look.entries
    engine = make_engine(environment(config), len(entries.episode), 0, entries)
    state = engine.reset()
    engine.close()
    look.completed()
    rows, first = [], 0
    for name, term in task.observations.items():
        values = term(state)
        span = slice(first, first + values.shape[1])
        mean, spread = policy.normaliser.mean[span], policy.normaliser.variance[span].sqrt().clamp_min(1e-3)
        for k, column in enumerate(((values - mean).abs() / spread).T):
            rows.append([name, k, round(float(column.max()), 3), float((column > FAR).double().mean())])
        first = span.stop
    return rows
