"""From the configuration of an evaluation to its options and meta-controller."""

from __future__ import annotations

from hrl_comfort.config import POLICIES, SORTING, ConfigError, EvaluateConfig
from hrl_comfort.hierarchy.executor import Choose, OptionExecutor
from hrl_comfort.hierarchy.meta_controllers import CHOICES, in_order
from hrl_comfort.hierarchy.options import Option, chain
from hrl_comfort.hierarchy.sort import sorting_options
from hrl_comfort.policies.load import Source, make_policy
from hrl_comfort.sim.engine import Engine
from hrl_comfort.tasks import Subtask, subtask


def make_executor(
    config: EvaluateConfig, policy: Source | None, engine: Engine, seed: int
) -> tuple[OptionExecutor, Choose]:
    """Return the options of a lone policy, a chain, `sort` or `shift`, and what chooses among them.

    `seed` is for random ones.

    Raises:
      ConfigError: a policy is missing or does not fit, or the meta-controller does not go with the task.
    """
    env, episodes, meta_controller = engine.episodes.config, engine.episodes, config.meta_controller
    task = episodes.subtask
    if meta_controller.name == "none":
        source = config.policy if policy is None else policy
        if source is None:
            raise ConfigError(f"policy=null: give {POLICIES}")
        rounds = len(task.stages) if task.repeats else 0
        alone = Option(task.name, task, make_policy(source, task, engine.scene, env, seed), round_stages=rounds)
        return OptionExecutor([alone], config.task.max_episode_steps, episodes, retries=0), in_order
    limit = meta_controller.time_limit_steps
    if task.name in SORTING:
        options = sorting_options(meta_controller, config.policies, engine.scene, env, seed)
        return OptionExecutor(options, limit, episodes), _sorter(config, [option.name for option in options], seed)
    check_given(config)
    if meta_controller.name != "scripted":
        raise ConfigError(
            f"meta_controller={meta_controller.name} is for task=sort and shift; "
            f"task={task.name} takes meta_controller=scripted"
        )
    for key, off in ("level_override", "[]"), ("max_waits", "null"):
        if (value := getattr(meta_controller, key)) not in (None, []):
            key = f"meta_controller.{key}"
            raise ConfigError(f"{key}={value} is for task=sort and shift; choose {key}={off}")
    parts = [subtask(name, hand=config.robot.gripper.holds) for name in meta_controller.options]
    check_stages(parts, task)
    skills = [(part, make_policy(config.policies[part.name], part, engine.scene, env, seed)) for part in parts]
    return OptionExecutor(chain(skills), limit, episodes, meta_controller.retries), in_order


def check_given(config: EvaluateConfig) -> None:
    """Raise ConfigError unless every option of the chain has a policy."""
    missing = [name for name in config.meta_controller.options if name not in config.policies]
    if missing:
        raise ConfigError(f"policies.{missing[0]} is not given; meta_controller={config.meta_controller.name} needs it")


def check_stages(parts: list[Subtask], task: Subtask) -> None:
    """Raise ConfigError unless the stages of the parts are those of the task."""
    stages = [stage for part in parts for stage in part.stages]
    if stages != list(task.stages):
        raise ConfigError(
            f"meta_controller.options={[part.name for part in parts]} do the stages {[s.name for s in stages]}; "
            f"task.name={task.name} needs {[stage.name for stage in task.stages]}"
        )


def _sorter(config: EvaluateConfig, options: list[str], seed: int) -> Choose:
    """Return the meta-controller of `sort` that `config` names."""
    if config.meta_controller.name != "learned":
        return CHOICES[config.meta_controller.name](seed)
    if "meta_controller" not in config.policies:
        raise ConfigError("policies.meta_controller is not given; meta_controller=learned needs it")
    from hrl_comfort.hierarchy.q_learning import load_choice  # seconds, for torchrl

    found, limit = config.policies["meta_controller"], config.meta_controller.max_waits
    return load_choice(found, config.comfort.levels, options, limit)
