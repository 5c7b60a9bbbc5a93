"""Words that stand for an override, and checks of what an override names, before the seconds that torch takes."""

from __future__ import annotations

import glob
import os
import re
import warnings
from collections.abc import Iterator
from ctypes.util import find_library
from importlib.util import find_spec
from pathlib import Path

from hrl_comfort.composition.policies import as_chain, check_beside, with_controller, with_defaults, with_skills
from hrl_comfort.composition.stages import stages_of
from hrl_comfort.config import (
    POLICIES,
    SCRIPTED_POLICIES,
    STARTS,
    ConfigError,
    EnvConfig,
    EvaluateConfig,
    FigureConfig,
    HierarchyTrainConfig,
    IdentifyConfig,
    MetaControllerTrainConfig,
    ReportConfig,
    StudioConfig,
    TrainConfig,
)
from hrl_comfort.config.checks import is_object, one_of
from hrl_comfort.config.commands import CommandConfig
from hrl_comfort.config.overrides import override
from hrl_comfort.files.run_config import warn_unfinished
from hrl_comfort.streams import pylsl_for

BARE = {
    **dict.fromkeys(("evaluate", "evaluate handover", "benchmark", "studio", "deploy"), "policy"),
    "report": "run",
    "results": "name",
}
"""Key of a word without `=`, by command: `evaluate runs/pick`."""


def completed(command: str, overrides: list[str], sweep: bool = False) -> list[str]:
    """Return `overrides` with words without `=` as values of the command's key in BARE, and with its defaults.

    Raises:
      ConfigError: there are several such words, without `sweep`.
    """
    key = BARE.get(command)
    words = [each for each in overrides if each and "=" not in each and each[0] not in "~+-"] if key else []
    if len(words) > 1 and not sweep:
        each_one = "; add -m to evaluate each" if command == "evaluate" else ""
        raise ConfigError(f"{' '.join(words)} are {len(words)} values of {key}=, which takes one{each_one}")
    if key is not None and words:
        values = ",".join(override(key, word).partition("=")[2] for word in words)
        overrides = [f"{key}={values}", *(each for each in overrides if each not in words)]
    if command in ("studio", "bench studio"):
        return with_defaults(overrides)
    if command == "deploy":
        return with_controller(overrides)
    if command == "benchmark":
        return with_skills(overrides)
    return as_chain(overrides) if key == "policy" else overrides


def check(config: CommandConfig) -> None:
    """Raise ConfigError if `config` names a policy, a folder, a column or a package that is not there.

    What is merely doubtful in its cell gets a warning.
    """
    for key, value in policies(config):
        if value is not None and not _is_there(value):
            raise ConfigError(f"{key}={value!r} is not there; give {POLICIES}")
        warn_unfinished(value)
    if (
        isinstance(config, TrainConfig | EvaluateConfig)
        and config.task.start not in STARTS
        and not Path(config.task.start).is_file()
    ):
        raise ConfigError(f"task.start={config.task.start!r} is neither 'ik' nor an existing .npz file")
    if isinstance(config, TrainConfig) and config.resume is None:
        if config.agent.name == "end_to_end":
            _check_begun_from(config)
        _check_next_skill_reward(config)
    if isinstance(config, TrainConfig) and config.logger == "wandb" and find_spec("wandb") is None:
        raise ConfigError("logger=wandb needs wandb: pip install 'hrl-comfort[wandb]'")
    match config:
        case StudioConfig():
            _need_viser()
            check_beside(config)
        case EvaluateConfig() if config.group_by:
            from hrl_comfort.evaluation.episode import COLUMNS  # numpy

            for name in config.group_by:
                one_of("group_by", name, COLUMNS)
        case ReportConfig() | IdentifyConfig() if not Path(config.run).is_dir():
            raise ConfigError(f"run={config.run!r} is not a folder")
        case FigureConfig():
            for pattern in config.evaluations:
                if not any(Path(each).is_dir() for each in (pattern, *glob.glob(pattern))):
                    raise ConfigError(f"evaluations={pattern!r} is not the folder of an evaluation")
    if (lost := _drawn(config)) and not _can_draw():
        from hrl_comfort.scene.camera import PACKAGES

        remedy = f"on Debian or Ubuntu: apt-get install {PACKAGES}"
        warnings.warn(f"{lost}, for off-screen OpenGL is not installed; {remedy}", stacklevel=2)
    if isinstance(config, EnvConfig):
        followed = [each for each in config.human.everyone if each.motion == "live"]
        for key, live in {
            "comfort.source": config.comfort.source == "lsl",
            "human.file": any((each.file or "").startswith("lsl:") for each in followed),
        }.items():
            if live:
                pylsl_for(key)
        live = config.comfort.source in ("udp", "lsl") or bool(followed)
        if live and isinstance(config, EvaluateConfig) and not config.realtime:
            warnings.warn("live values come by the wall clock, episodes run faster: add realtime=true", stacklevel=2)
        from hrl_comfort.scene.layout import layout_warnings  # mujoco, once all else is right

        for warning in layout_warnings(config):
            warnings.warn(warning, stacklevel=2)


def _check_begun_from(config: TrainConfig) -> None:
    """Raise ConfigError if a training end to end lacks the skills that it begins with."""
    skills, initial = config.agent.own["skills"], config.initial_policy
    if isinstance(config, HierarchyTrainConfig):
        raise ConfigError(
            "agent=end_to_end does not go with train hierarchy, whose options are trained one by one; train them with "
            "agent=sac, then say train task=cycle agent=end_to_end initial_policy=FOLDER"
        )
    if initial is None:
        raise ConfigError(
            f"agent=end_to_end goes on from trained skills: give initial_policy=FOLDER with the runs "
            f"{', '.join(skills)} (agent.own.skills), such as the output of train hierarchy"
        )
    for name in skills:
        if not (Path(initial) / name).exists():
            raise ConfigError(
                f"initial_policy={initial!r} has no {name}, which is one of agent.own.skills={skills}; give the folder "
                "of a hierarchy that has"
            )


def _check_next_skill_reward(config: TrainConfig) -> None:
    """Raise ConfigError if a training has a reward for likeness to the starts of a skill that it does not name."""
    if isinstance(config, HierarchyTrainConfig):
        if (reward := config.agent.next_skill_reward) and not config.hierarchy.refinement:
            raise ConfigError(
                f"agent.next_skill_reward={reward:g} is for the refinement of options, and "
                "hierarchy.refinement=[] refines none: choose experiment=t_star, or leave agent.next_skill_reward out"
            )
        return
    for _, stage in stages_of(config):
        if (reward := stage.agent.next_skill_reward) and stage.agent.next_skill is None:
            raise ConfigError(
                f"agent.next_skill_reward={reward:g} is for ends where agent.next_skill begins, and there is none: "
                "give agent.next_skill=RUN, or leave agent.next_skill_reward out"
            )


def _drawn(config: CommandConfig) -> str | None:
    """Return what a command cannot do without off-screen OpenGL."""
    match config:
        case HierarchyTrainConfig() | ReportConfig(video=True):
            return "the report will have no video"
        case StudioConfig():
            return "clips cannot be saved"
    return None


def _can_draw() -> bool:
    """Return whether the OpenGL library is there that pictures are drawn with (`scene.camera`)."""
    return find_library("OSMesa" if os.environ.get("MUJOCO_GL", "").lower() == "osmesa" else "EGL") is not None


def policies(config: CommandConfig) -> Iterator[tuple[str, str | None]]:
    """Yield the keys that name policies, with their values."""
    if isinstance(config, EvaluateConfig):
        yield "policy", config.policy
    if isinstance(config, EvaluateConfig | MetaControllerTrainConfig):
        yield from ((f"policies.{name}", source) for name, source in config.policies.items())
    if isinstance(config, StudioConfig):
        yield "beside", config.beside
    if isinstance(config, TrainConfig):
        yield "agent.demonstrator", config.agent.demonstrator
        yield "agent.next_skill", config.agent.next_skill
        yield "initial_policy", config.initial_policy


def _is_there(policy: str) -> bool:
    file = re.sub(r"^\w+:", "", policy)  # sb3:FILE
    return policy in SCRIPTED_POLICIES or is_object(policy) or Path(file).exists()


def _need_viser() -> None:
    missing = [name for name in ("viser", "trimesh", "websockets") if find_spec(name) is None]
    if missing:
        raise ConfigError(f"studio needs {missing[0]}: pip install 'hrl-comfort[studio]'")
