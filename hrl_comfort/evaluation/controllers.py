"""From the configuration of an evaluation to what acts in it."""

from __future__ import annotations

from hrl_comfort.config import ConfigError, EvaluateConfig
from hrl_comfort.config.compose import environment
from hrl_comfort.hierarchy.controllers import Controller, Scripted, chain, single
from hrl_comfort.hierarchy.executor import OptionExecutor
from hrl_comfort.hierarchy.meta_controllers import make_choice
from hrl_comfort.hierarchy.options import Option
from hrl_comfort.hierarchy.q_learning import load_choice
from hrl_comfort.hierarchy.sort import SortController, sorting_options
from hrl_comfort.policies.load import SCRIPTED, make_policy
from hrl_comfort.sim.engine import Engine
from hrl_comfort.tasks import subtask


def make_controller(config: EvaluateConfig, policy: str | None, engine: Engine, seed: int) -> Controller:
    """Return the controller of a lone policy or of a chain (`meta_controller=scripted`); `seed` is for random ones."""
    env, scene, task = environment(config), engine.scene, engine.episodes.subtask
    if config.meta_controller.name == "none":
        source = policy or config.policy
        if source is None:
            raise ConfigError(f"policy=null: give a run folder, a checkpoint, a policy.pt, {' or '.join(SCRIPTED)}")
        act = make_policy(source, task, scene, env, seed)
        return single(task, Option(task.name, task, act), config.task.max_episode_steps, config.comfort)
    if config.task.name == "sort":
        return _controller(config, engine, seed)
    missing = [name for name in config.meta_controller.options if name not in config.policies]
    if missing:
        raise ConfigError(f"policies.{missing[0]} is not given; meta_controller={config.meta_controller.name} needs it")
    if config.meta_controller.name != "scripted":
        raise ConfigError(
            f"meta_controller={config.meta_controller.name} is for task=sort; "
            f"task={config.task.name} takes meta_controller=scripted"
        )
    if config.meta_controller.level_override:
        raise ConfigError(
            f"meta_controller.level_override={list(config.meta_controller.level_override)} is for task=sort; "
            "choose meta_controller.level_override=[]"
        )
    options = []
    for name in config.meta_controller.options:
        part = subtask(name)
        act = make_policy(config.policies[name], part, scene, env, seed)
        options.append(Option(name, part, act))
    return Scripted(config.meta_controller, task, chain(options), config.comfort)


def _controller(config: EvaluateConfig, engine: Engine, seed: int) -> Controller:
    """Return what sorts, choosing as `config.meta` says."""
    executor = OptionExecutor(
        sorting_options(config.meta_controller, config.policies, engine.scene, environment(config), seed),
        config.meta_controller.time_limit_steps,
        engine.episodes,
    )
    if config.meta_controller.name == "learned":
        if "meta_controller" not in config.policies:
            raise ConfigError("policies.meta_controller is not given; meta_controller=learned needs it")
        choose = load_choice(
            config.policies["meta_controller"], config.comfort.levels, [o.name for o in executor.options]
        )
    else:
        choose = make_choice(config.meta_controller.name, seed)
    return SortController(executor, choose)
