"""`hrl-comfort VERB -m`: every combination of the swept overrides, each in a folder of its own."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from hydra import version
from hydra._internal.hydra import Hydra
from hydra._internal.utils import create_config_search_path
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf.errors import OmegaConfBaseException

from hrl_comfort.config import ConfigError
from hrl_comfort.config.checks import filled
from hrl_comfort.config.overrides import config_dir, one_line, override, root_of
from hrl_comfort.files.sweep_record import find_jobs, planned
from hrl_comfort.sweeps.job import ERRORS, Ended, Run, job

EXTRAS = {
    "submitit_local": ("submitit", "hydra_plugins.hydra_submitit_launcher"),
    "submitit_slurm": ("submitit", "hydra_plugins.hydra_submitit_launcher"),
    "ray": ("ray", "hydra_plugins.hydra_ray_launcher"),
    "optuna": ("optuna", "hydra_plugins.hydra_optuna_sweeper"),
}
"""Launchers and sweepers that need an extra: its name, and the module that it brings."""


def multirun(verb: str, run: Run, checked: list[str], outputs: list[str]) -> None:
    """Run `verb` once for every combination of the swept overrides, each in its own folder.

    `checked` is what `compose.check_overrides` returns, `outputs` what `output=` says. Jobs run in parallel,
    unless a launcher says otherwise.

    Raises:
      ConfigError: a choice is not allowed, or jobs are not done; the others have gone on.
    """
    rest = [*checked, *(line for each in outputs for line in _folders(each))]
    rest += _of_plugins(rest)
    version.setbase("1.3")
    hydra_app = Hydra.create_main_hydra2("hrl-comfort", create_config_search_path(str(config_dir())))
    command, batches, broke = uuid.uuid4().hex, None, ""
    task = partial(job, verb, run, command)
    root = root_of(verb)
    try:
        asked = hydra_app.compose_config(root, rest, RunMode.MULTIRUN, with_log_configuration=False)
        folder = Path(asked.hydra.sweep.dir)
        rest.append(override("hydra.sweep.dir", folder))  # it may hold the time, which goes on
        batches = hydra_app.multirun(root, task, rest, with_log_configuration=False)
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(one_line(error)) from error
    except ERRORS:
        raise
    except Exception as error:  # noqa: BLE001  of a launcher or sweeper, whose classes only its extra knows
        broke = f"{type(error).__name__}: {' '.join(str(error).split())}"
    finally:
        GlobalHydra.instance().clear()
    if batches is None:
        _say_from_records(folder, command, broke)
    else:
        _say([(each.overrides or (), each.return_value) for batch in batches for each in batch])


def _say(jobs: list[tuple[Sequence[str], Ended]]) -> None:
    """Print how each job, of these overrides, ended; raise ConfigError if one is not done."""
    not_done = 0
    for overrides, ended in jobs:
        not_done += ended.problem is not None
        print(f"{ended.what}: {' '.join(overrides)}: {ended.problem or ended.folder}")
    if not_done:
        raise ConfigError(f"{not_done} of {len(jobs)} jobs failed")


def _say_from_records(folder: Path, command: str, broke: str) -> None:
    """Print how the jobs stand where the sweeper returned nothing: Optuna's, or one that an error ended."""
    jobs = {where: each for where, each in find_jobs(folder).items() if each.command == command}
    for where, each in jobs.items():
        print(f"{each.state}: {' '.join(each.overrides)}: {each.why or where}")
    begun = {each.overrides for each in jobs.values()}
    waiting = [each for each in planned(folder) if each not in begun] if broke else []
    for overrides in waiting:
        print(f"not begun: {' '.join(overrides)}")
    not_done = sum(each.state != "done" for each in jobs.values()) + len(waiting)
    if broke:
        raise ConfigError(
            f"{not_done} of {len(jobs) + len(waiting)} jobs are not done ({broke}); "
            "the same command again does what is left"
        )
    if not_done:
        raise ConfigError(f"{not_done} of {len(jobs)} jobs failed")


def _of_plugins(overrides: list[str]) -> list[str]:
    """Return what the chosen sweeper has to be told besides; raise ConfigError where an extra is missing."""
    chosen = dict(line.split("=", 1) for line in overrides if line.startswith("hydra/"))
    for key in ("hydra/launcher", "hydra/sweeper"):
        extra, module = EXTRAS.get(chosen.get(key, ""), ("", ""))
        if extra and find_spec(module) is None:
            what = f"{key}={chosen[key]}"
            raise ConfigError(f"{what} needs the extra {extra}: pip install 'hrl-comfort[{extra}]'")
    if chosen.get("hydra/sweeper") != "optuna":
        return []
    wanted = {"hydra.sweeper.direction": "maximize"}
    if chosen.get("hydra/sweeper/sampler") != "grid":  # which draws nothing
        wanted["hydra.sweeper.sampler.seed"] = "0"  # so that the same command asks for the same trials
    return [
        f"{key}={value}" for key, value in wanted.items() if not any(line.startswith(f"{key}=") for line in overrides)
    ]


def _folders(output: str) -> list[str]:
    """Return what tells Hydra where the jobs write: in `output`, numbered, unless it says `${...}` itself."""
    output = output.strip("'\"")
    filled("output", output)
    head, sign, tail = output.partition("${")
    if not sign:
        return [f"hydra.sweep.dir='{output}'"]
    above, _, name = head.rpartition("/")
    return [f"hydra.sweep.dir='{above or '.'}'", f"hydra.sweep.subdir='{name}{sign}{tail}'"]
