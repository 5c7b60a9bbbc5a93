"""`hrl-comfort VERB -m`: every combination of the swept overrides, each in its own folder."""

from __future__ import annotations

import os
import time
import uuid
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf.errors import OmegaConfBaseException

from hrl_comfort.config import ConfigError
from hrl_comfort.config.checks import one_of
from hrl_comfort.config.hydra_conf import hydra_over_conf, run_folder
from hrl_comfort.config.overrides import one_line, override, parse, root_of
from hrl_comfort.files.atomic import overwrites, target_of
from hrl_comfort.files.documents import read_yaml
from hrl_comfort.files.output import INSIST, in_use
from hrl_comfort.files.sweep_record import find_jobs, planned
from hrl_comfort.sweeps.job import Command, job
from hrl_comfort.sweeps.subprocesses import ERRORS, end_with_parent

POLL_S = 1.0
EXTRAS = {
    "hydra/launcher": {
        "submitit_local": ("submitit", "hydra_plugins.hydra_submitit_launcher"),
        "submitit_slurm": ("submitit", "hydra_plugins.hydra_submitit_launcher"),
        "ray": ("ray", "hydra_plugins.hydra_ray_launcher"),
    },
    "hydra/sweeper": {"optuna": ("optuna", "hydra_plugins.hydra_optuna_sweeper")},
}
"""Extra and module of each launcher and sweeper that needs one."""


def multirun(verb: str, run: Command, checked: list[str], outputs: list[str]) -> None:
    """Run `verb` once for every combination of the swept overrides and print how each job ended.

    `checked` are overrides from `check_overrides`, `outputs` the values of `output=`.

    Raises:
      ConfigError: a choice is not allowed, or a job is not done; the other jobs have run.
    """
    rest = [*checked, *(line for each in outputs for line in _folder_overrides(each))]
    if verb == "evaluate" and not outputs and _of_runs(checked):
        rest.append("hydra.sweep.subdir='${absolute:${output}}'")  # the eval/ of each
    os.environ.setdefault("RAY_worker_niceness", "0")  # Ray's own 15 lets a busy machine starve the jobs
    command, batches, crash = uuid.uuid4().hex, None, ""
    task = partial(job, verb, run, command)
    root = root_of(verb)
    try:
        with hydra_over_conf() as state:
            assert state.hydra is not None
            rest += _plugin_overrides(rest, state.config_loader().get_group_options)
            asked = state.hydra.compose_config(root, rest, RunMode.MULTIRUN, with_log_configuration=False)
            folder = Path(asked.hydra.sweep.dir)
            record = target_of(folder / "multirun.yaml")
            if record.exists() and not overwrites() and "hydra" not in read_yaml(record)[1]:
                raise ConfigError(f"{record} is not the record of a sweep; {INSIST}")
            rest.append(override("hydra.sweep.dir", folder))  # its default holds the time, which must not change
            batches = state.hydra.multirun(root, task, rest, with_log_configuration=False)
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(one_line(error)) from error
    except ERRORS:
        raise
    except Exception as error:  # noqa: BLE001  launchers and sweepers of extras raise classes of their own
        crash = f"{type(error).__name__}: {' '.join(str(error).split())}"
    if batches is None:
        if crash:
            _wait(folder, command)
        _report_records(folder, command, crash)
        return
    results = [(each.overrides or (), each.return_value) for batch in batches for each in batch]
    for overrides, result in results:
        print(f"{result.status}: {' '.join(overrides)}: {result.error or result.folder}")
    failed = sum(result.error is not None for _, result in results)
    if failed:
        raise ConfigError(f"{failed} of {len(results)} jobs failed")


def _wait(folder: Path, command: str) -> None:
    """Wait for the jobs that still run on this machine: a launcher that raised has left them."""
    for where, each in find_jobs(folder).items():
        while each.command == command and each.state == "running" and in_use(where):
            time.sleep(POLL_S)


def _report_records(folder: Path, command: str, crash: str) -> None:
    """Print the jobs from their records: Optuna returns none, nor does a launcher that raised `crash`.

    A record says `running` if its job was killed. On a cluster, such a job may also still run.
    """
    jobs = {where: each for where, each in find_jobs(folder).items() if each.command == command}
    for where, each in jobs.items():
        lost = each.state == "running"
        why = f"no result in {where}: it was killed, or still runs" if lost else each.why or where
        print(f"{'failed' if lost else each.state}: {' '.join(each.overrides)}: {why}")
    started = {each.overrides for each in jobs.values()}
    waiting = [each for each in planned(folder) if each not in started] if crash else []
    for overrides in waiting:
        print(f"not started: {' '.join(overrides)}")
    not_done, count = sum(each.state != "done" for each in jobs.values()) + len(waiting), len(jobs) + len(waiting)
    if crash:
        raise ConfigError(
            f"{not_done} of {count} jobs are not done ({crash}); run the same command again to finish them"
        )
    if not_done:
        raise ConfigError(f"{not_done} of {count} jobs failed")


def _plugin_overrides(overrides: list[str], installed: Callable[[str], list[str]]) -> list[str]:
    """Return further overrides for the chosen launcher and sweeper, of which `installed` gives the choices.

    Raises:
      ConfigError: there is no such choice, or its extra is missing.
    """
    lines = [parse(line) for line in overrides if line.startswith("hydra/")]
    chosen = {each.key_or_group: str(each.value()) for each in lines}
    for key, extras in EXTRAS.items():
        if key in chosen:
            one_of(key, chosen[key], tuple(sorted({*installed(key), *extras})))
            extra, module = extras.get(chosen[key], ("", ""))
            if extra and find_spec(module) is None:
                raise ConfigError(f"{key}={chosen[key]} needs the extra {extra}: pip install 'hrl-comfort[{extra}]'")
    found = _worker_overrides() if chosen.get("hydra/launcher", "joblib") == "joblib" else []
    if chosen.get("hydra/sweeper") != "optuna":
        return found
    wanted = {"hydra.sweeper.direction": "maximize"}
    if chosen.get("hydra/sweeper/sampler") != "grid":  # which has no seed
        wanted["hydra.sweeper.sampler.seed"] = "0"  # the same command repeats the same trials
    return found + [
        f"{key}={value}" for key, value in wanted.items() if not any(line.startswith(f"{key}=") for line in overrides)
    ]


def _worker_overrides() -> list[str]:
    """Return Hydra's overrides by which joblib's workers, idle ones too, end with this process."""
    place = f"{end_with_parent.__module__}.{end_with_parent.__name__}"
    return [
        f"+hydra.launcher.initializer={{_target_: hydra.utils.get_method, path: {place}}}",
        f"+hydra.launcher.initargs=[{os.getpid()}]",
    ]


def _of_runs(overrides: list[str]) -> bool:
    """Return whether `policy` alone is swept, over one policy each of several run folders."""
    swept = [each for each in map(parse, overrides) if each.is_sweep_override()]
    if [each.key_or_group for each in swept] != ["policy"]:
        return False
    folders = [run_folder(str(each).strip("'\"")) for each in swept[0].sweep_string_iterator()]
    return None not in folders and len(set(folders)) == len(folders)


def _folder_overrides(output: str) -> list[str]:
    """Return Hydra's overrides for `output`: numbered subfolders, unless it contains `${...}`."""
    output = output.strip("'\"")
    if not output:
        raise ConfigError("output='' is empty; it takes a value")
    head, sign, tail = output.partition("${")
    if not sign:
        return [f"hydra.sweep.dir='{output}'"]
    parent, _, name = head.rpartition("/")
    return [f"hydra.sweep.dir='{parent or '.'}'", f"hydra.sweep.subdir='{name}{sign}{tail}'"]
