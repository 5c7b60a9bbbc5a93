"""Hierarchical reinforcement learning of pick, place and return beside a human, with comfort levels."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from os import PathLike, fspath
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dm_control.rl.control import Environment
    from pandas import DataFrame

    from hrl_comfort.config import EnvConfig, EvaluateConfig
    from hrl_comfort.policies.external import Function, ObservationPolicy

__version__ = "0.2.0"

# dm_control warns on import without a display; rendering off-screen is intended.
warnings.filterwarnings("ignore", message=".*DISPLAY environment variable is missing")


def environment_of(
    task: str | None = None, choices: Mapping[str, object] | None = None, run: str | PathLike[str] | None = None
) -> EnvConfig:
    """Return the configuration of an environment, for `hrl_comfort.envs.torchrl.CellEnv`; see `load`.

    Raises:
      ConfigError: a choice is not allowed, or `run` is none, or of another task.
      TypeError: a key of `choices` is not one of the configuration, as for any unknown keyword.
    """
    from hrl_comfort.composition.compose import compose_environment
    from hrl_comfort.config import ConfigError
    from hrl_comfort.config.checks import UnknownKeyError
    from hrl_comfort.config.overrides import groups, override
    from hrl_comfort.files.run_config import trained_environment, warn_unfinished

    given = dict(choices or {})
    if run is None:
        given = {"task": task or "pick", **given}
        root = "train_hierarchy" if given.get("experiment") in groups("train_hierarchy")["experiment"] else "train"
    else:
        run, root = fspath(run), "evaluate"
        trained = trained_environment(run)
        if trained is None:
            raise ConfigError(f"run={run!r} is not the run folder or policy file of a training, such as runs/demo/pick")
        if task not in (None, trained.task.name):
            raise ConfigError(f"run={run!r} was trained for task={trained.task.name}, not {task}; name that, or none")
        warn_unfinished(run)
        given = {"policy": run, **given}
    try:
        return compose_environment(root, [override(key, value) for key, value in given.items()])
    except UnknownKeyError as error:
        name = given.get("task", run)
        raise TypeError(f"{name} got an unexpected keyword argument {error.key!r}: {error}") from None


def options_of(
    task: str = "kitting", choices: Mapping[str, object] | None = None, run: str | PathLike[str] | None = None
) -> EvaluateConfig:
    """Return the configuration of an environment of options, for `hrl_comfort.hierarchy.option_env.make_option_env`.

    Args:
      task: `kitting`, `sort` or `shift`.
      choices: overrides of `hrl-comfort evaluate`; `policies` names those of the skills, scripted ones by default.
      run: run folder of a hierarchy, whose skills are taken with the world of their training, or of `train
        meta_controller`, whose world and skills are taken.

    Raises:
      ConfigError: a choice is not allowed, or `run` is none, or of another task.
      TypeError: a key of `choices` is not one of the configuration.
    """
    from hrl_comfort.composition.options import compose_options

    return compose_options(task, choices or {}, None if run is None else fspath(run))


def load(
    task: str | None = None,
    seed: int = 0,
    flat_observation: bool = False,
    run: str | PathLike[str] | None = None,
    **choices: object,
) -> Environment:
    """Return a dm_control Environment of one cell; the same `seed` gives the same episodes.

    The environment in which a policy was trained, and its policy in it:

        import hrl_comfort
        run = "runs/demo/pick"
        policy, env = hrl_comfort.load_policy(run), hrl_comfort.load(run=run, flat_observation=True)
        step = env.reset()
        while not step.last():
            step = env.step(policy(step.observation["observations"]))

    Args:
      task: the subtask; by default that of `run`, or `pick`.
      seed: seed of the episodes.
      flat_observation: whether the observation is one array, `observations`, not one for each term.
      run: run folder, checkpoint or policy file; the environment is that of its training (as `evaluate policy=` has it:
        all but `engine`), from any working directory.
      choices: command-line overrides, over those of `run`: `load("pick", human="arc", robot="ur5e")`, an experiment,
        `load("pick", experiment="shielded")`, or, for a dotted key, `load("pick", **{"human.speed_m_s": 1.0})`.

    Raises:
      ConfigError: a choice is not allowed, `run` is none or of another task, or `seed` is not a whole number from 0 to
        2**32 - 1.
      TypeError: an unknown keyword.
    """
    from hrl_comfort.envs.dm import make_environment

    return make_environment(environment_of(task, choices, run), seed, flat_observation)


def load_policy(source: str | PathLike[str]) -> ObservationPolicy:
    """Return a policy as a function: observations (N, D) to actions (N, A), or one observation (D,) to one action (A,).

    `source` is what `policy=` takes: a run folder, a checkpoint, a policy file, `sb3:FILE.zip` or
    `package.module:callable`.

    Raises:
      ConfigError: there is none, or it acts on the state of the cell (`expert`, `potential_field`, `random`).
    """
    from hrl_comfort.policies.load import observation_policy

    return observation_policy(fspath(source))


def evaluate(
    policy: str | PathLike[str] | Function,
    task: str | None = None,
    episodes: int = 100,
    levels: Sequence[int] = (),
    **choices: object,
) -> DataFrame:
    """Return the episodes of a policy on the evaluation set, the columns of episodes.csv (docs/metrics.md).

    Args:
      policy: what `policy=` takes, a policy from `load_policy`, or any callable from observations (N, D), float32, to
        actions (N, A) in [-1, 1]. docs/bring_your_own.md has the layout of the observations.
      task: the subtask; by default that of the policy's training, or `pick`.
      episodes: number of episodes, at each level.
      levels: comfort levels to evaluate on the same episodes.
      choices: overrides of `hrl-comfort evaluate`, such as `human="arc"` or `split="validation"`.

    Raises:
      ConfigError: a choice is not allowed, or the policy does not fit.
    """
    from hrl_comfort.composition.compose import compose
    from hrl_comfort.config import EvaluateConfig
    from hrl_comfort.config.overrides import override
    from hrl_comfort.evaluation.rollout import rollout
    from hrl_comfort.files.run_config import warn_unfinished
    from hrl_comfort.policies.external import ObservationPolicy

    source = policy.source if isinstance(policy, ObservationPolicy) else policy
    given = source if callable(source) else fspath(source)
    asked = {**({} if task is None else {"task": task}), "episodes": episodes, "levels": list(levels), **choices}
    if isinstance(given, str):
        warn_unfinished(given)
        asked = {"policy": given, **asked}
    config = compose("evaluate", [override(key, value) for key, value in asked.items()])
    assert isinstance(config, EvaluateConfig)
    return rollout(config, given if callable(given) else None).table


__all__ = ["__version__", "environment_of", "evaluate", "load", "load_policy", "options_of"]
