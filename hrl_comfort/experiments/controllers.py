"""From the configuration of an evaluation to what acts in it."""

from __future__ import annotations

from hrl_comfort.compose import environment
from hrl_comfort.config import ConfigError, EvaluateConfig
from hrl_comfort.meta.choices import make_choice
from hrl_comfort.meta.controllers import Controller, Scripted, chain, single
from hrl_comfort.meta.options import SCRIPTED, Option, make_policy
from hrl_comfort.meta.q_learning import load_choice
from hrl_comfort.meta.running import Running
from hrl_comfort.meta.sorting import Sorting, sorting_options
from hrl_comfort.sim.engine import Engine
from hrl_comfort.tasks import subtask


def make_controller(config: EvaluateConfig, policy: str | None, engine: Engine, seed: int) -> Controller:
    """Return what acts: a chain of policies (`meta=scripted`), or a lone one; `seed`: what acts at random."""
    env, scene, task = environment(config), engine.scene, engine.episodes.subtask
    if config.meta.name == "none":
        source = policy or config.policy
        if source is None:
            raise ConfigError(
                f"policy=null: give a run folder, a checkpoint, a policy.pt, {' or '.join(SCRIPTED)}"
            )
        act = make_policy(source, task, scene, env, seed)
        return single(task, Option(task.name, task, act), config.task.limit_steps, config.comfort)
    if config.task.name == "sort":
        return _sorting(config, engine, seed)
    missing = [name for name in config.meta.options if name not in config.policies]
    if missing:
        raise ConfigError(f"policies.{missing[0]} is not given; meta={config.meta.name} needs it")
    if config.meta.name != "scripted":
        raise ConfigError(
            f"meta={config.meta.name} is for task=sort; task={config.task.name} takes meta=scripted"
        )
    if config.meta.tell:
        raise ConfigError(f"meta.tell={list(config.meta.tell)} is for task=sort; choose meta.tell=[]")
    options = []
    for name in config.meta.options:
        part = subtask(name)
        act = make_policy(config.policies[name], part, scene, env, seed)
        options.append(Option(name, part, act))
    return Scripted(config.meta, task, chain(options), config.comfort)


def _sorting(config: EvaluateConfig, engine: Engine, seed: int) -> Controller:
    """Return what sorts, choosing as `config.meta` says."""
    running = Running(
        sorting_options(config.meta, config.policies, engine.scene, environment(config), seed),
        config.meta.time_limit_steps,
        engine.episodes,
    )
    if config.meta.name == "learned":
        if "meta" not in config.policies:
            raise ConfigError("policies.meta is not given; meta=learned needs it")
        choose = load_choice(
            config.policies["meta"], config.comfort.levels, [o.name for o in running.options]
        )
    else:
        choose = make_choice(config.meta.name, seed)
    return Sorting(running, choose)
