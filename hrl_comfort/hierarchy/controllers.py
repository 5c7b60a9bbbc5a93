"""From the configuration of an evaluation to its options and meta-controller."""

from __future__ import annotations

from hrl_comfort.config import POLICIES, SORTING, ConfigError, EvaluateConfig, MetaControllerConfig
from hrl_comfort.config.hierarchy import LOOKAHEAD, ORACLE
from hrl_comfort.hierarchy.decision import Top
from hrl_comfort.hierarchy.executor import OptionExecutor
from hrl_comfort.hierarchy.look_ahead import FUTURES, LookAhead
from hrl_comfort.hierarchy.options import OptionTable, chain, skill
from hrl_comfort.hierarchy.own_options import with_own
from hrl_comfort.hierarchy.sort import recovery, sorting_table
from hrl_comfort.hierarchy.tops import in_order, make_top
from hrl_comfort.policies.load import Source, make_policy
from hrl_comfort.sim.engine import Engine
from hrl_comfort.tasks import Subtask, subtask


def make_executor(
    config: EvaluateConfig, policy: Source | None, engine: Engine, seed: int
) -> tuple[OptionExecutor, Top]:
    """Return the options of a lone policy, of a chain or of SORTING, and what chooses among them.

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
        rounds, act = len(task.stages) if task.repeats else 0, make_policy(source, task, engine.scene, env, seed)
        alone = skill(task, act, config.task.max_episode_steps, round_stages=rounds)
        return OptionExecutor(OptionTable([alone]), episodes, retries=0), Top("none", in_order)
    if task.name in SORTING:
        table, retries = sorting_table(meta_controller, config.policies, engine.scene, env, seed), None
    else:
        table, retries = _chain(config, engine, seed), meta_controller.retries
    executor = OptionExecutor(table, episodes, retries)
    if (name := meta_controller.name) in (ORACLE, LOOKAHEAD):
        top = LookAhead(engine, executor, FUTURES if name == LOOKAHEAD else 0)
        return executor, Top(name, top, together=True, values=top.values)
    made = make_top(config, table, seed)
    if task.name not in SORTING:
        check_unread(meta_controller)
    return executor, made


def _chain(config: EvaluateConfig, engine: Engine, seed: int) -> OptionTable:
    """Return the options of a task that is a chain of subtasks, with one to recover where a hand may drop things."""
    env, task, meta_controller = engine.episodes.config, engine.episodes.subtask, config.meta_controller
    parts = [subtask(name, hand=config.robot.gripper.holds) for name in meta_controller.options]
    check_stages(parts, task)
    check_given(config)
    skills = [(part, make_policy(config.policies[part.name], part, engine.scene, env, seed)) for part in parts]
    drops = any(stage.dropped is not None for stage in task.stages)
    recovering = [recovery(engine.scene, env, seed)] if drops else []
    table = chain(skills, meta_controller.time_limit_steps, recovering)
    return OptionTable(with_own([*table], meta_controller, engine.scene, env, seed))


def check_unread(meta_controller: MetaControllerConfig) -> None:
    """Raise ConfigError if a key is set that a chain does not read."""
    for key, off in ("level_override", "[]"), ("max_waits", "null"):
        if (value := getattr(meta_controller, key)) not in (None, []):
            key = f"meta_controller.{key}"
            raise ConfigError(f"{key}={value} is for task={', '.join(SORTING)}; choose {key}={off}")


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
