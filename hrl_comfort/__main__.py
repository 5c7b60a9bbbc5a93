"""`hrl-comfort VERB [overrides]`: the commands. Nothing heavy is imported before it is needed."""

from __future__ import annotations

import os
import signal
import sys
import warnings
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path

from hrl_comfort.config import (
    ConfigError,
    EvaluateConfig,
    FigureConfig,
    MetaTrainConfig,
    ReportConfig,
    TrainConfig,
)
from hrl_comfort.experiments.preemption import Preempted

VERBS = {
    "train": "teach one subtask to one policy, or a controller above them (train meta)",
    "evaluate": "measure a policy, or a chain of them (meta=scripted), on the evaluation set",
    "report": "write one HTML file about the runs in a folder (run=DIR)",
    "figure": "draw what levels or controllers change (kind=levels evaluations=[DIR,...] output=FILE.png)",
    "bench": "measure the environment (env), updates (update), learning (train), cores, starts (start)",
    "demo": "train, evaluate, chain and report, in minutes",
}

ERRORS = (ConfigError, FloatingPointError, OSError)
"""What gets one line and no traceback: a wrong choice, a training that diverged, a file that is not there."""


def train(overrides: list[str]) -> None:
    """Run `hrl-comfort train`."""
    from hrl_comfort.compose import compose

    if overrides[:1] == ["meta"]:
        controller = compose("train_meta", overrides[1:])
        assert isinstance(controller, MetaTrainConfig)
        from hrl_comfort.experiments.train_meta import train_meta

        train_meta(controller)
        return
    config = compose("train", overrides)
    assert isinstance(config, TrainConfig)
    others = [line for line in overrides if not line.startswith("resume=")]
    if config.resume is not None and others:
        raise ConfigError(f"resume= goes on as the run was configured; leave out {' '.join(others)}")
    from hrl_comfort.experiments.train_cell import train_cell

    train_cell(config)


def evaluate(overrides: list[str]) -> None:
    """Run `hrl-comfort evaluate`."""
    from hrl_comfort.compose import compose

    seams = overrides[:1] == ["handover"]
    config = compose("evaluate", overrides[1:] if seams else overrides)
    assert isinstance(config, EvaluateConfig)
    if seams:
        from hrl_comfort.experiments.handover import handover as run
    elif config.endings is not None:
        from hrl_comfort.experiments.endings import record_endings as run
    else:
        from hrl_comfort.experiments.evaluate import evaluate as run

    run(config)


def report(overrides: list[str]) -> None:
    """Run `hrl-comfort report`."""
    from hrl_comfort.compose import compose

    config = compose("report", overrides)
    assert isinstance(config, ReportConfig)
    from hrl_comfort.experiments.report import report as run

    run(config)


def figure(overrides: list[str]) -> None:
    """Run `hrl-comfort figure`."""
    from hrl_comfort.compose import compose

    config = compose("figure", overrides)
    assert isinstance(config, FigureConfig)
    from hrl_comfort.experiments.figure import figure as run

    run(config)


BENCHMARKS = {
    "env": "hrl_comfort.experiments.bench:bench_env",
    "update": "hrl_comfort.experiments.bench_update:bench_update",
    "train": "hrl_comfort.experiments.bench_train:bench_train",
    "cores": "hrl_comfort.experiments.bench_cores:bench_cores",
}
"""Imported when asked for; they need the simulator, and some of them peers."""


def bench(words: list[str]) -> None:
    """Run one of the benchmarks."""
    if not words or words[0] not in (*BENCHMARKS, "start"):
        what = words[0] if words else "(nothing)"
        raise ConfigError(f"bench {what} is not known; say bench {', '.join(BENCHMARKS)} or start")
    from hrl_comfort.compose import compose

    config = compose("train", words[1:])
    assert isinstance(config, TrainConfig)
    if words[0] == "start":
        from hrl_comfort.experiments.bench_start import bench_start

        bench_start(config, words[1:])
        return
    module, name = BENCHMARKS[words[0]].split(":")
    getattr(import_module(module), name)(config)


def demo(overrides: list[str]) -> None:
    """Run `hrl-comfort demo`."""
    from hrl_comfort.experiments.demo import demo as run

    run(overrides)


RUN: dict[str, Callable[[list[str]], None]] = {
    "train": train,
    "evaluate": evaluate,
    "report": report,
    "figure": figure,
    "bench": bench,
    "demo": demo,
}

SWEPT = ("train", "evaluate")


def multirun(verb: str, overrides: list[str]) -> None:
    """Run `verb` once for every combination of the swept overrides, in parallel, each in its own folder."""
    from hydra import version
    from hydra._internal.hydra import Hydra
    from hydra._internal.utils import create_config_search_path
    from hydra.core.global_hydra import GlobalHydra
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    from hrl_comfort.compose import check_overrides, config_dir, one_line

    if verb not in SWEPT:
        raise ConfigError(f"{verb} cannot be swept; -m goes with {', '.join(SWEPT)}")
    if any(line.split("=")[0] == "resume" for line in overrides):
        raise ConfigError("resume does not go with -m: give one run at a time")
    outputs = [line.split("=", 1)[1] for line in overrides if line.startswith("output=")]
    rest = [line for line in overrides if not line.startswith("output=")]
    rest = [*check_overrides(verb, rest, sweep=True), *(line for each in outputs for line in _folders(each))]
    version.setbase("1.3")
    try:
        hydra_app = Hydra.create_main_hydra2("hrl-comfort", create_config_search_path(str(config_dir())))
        (jobs,) = hydra_app.multirun(verb, partial(_job, verb), rest, with_log_configuration=False)
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(one_line(error)) from error
    finally:
        GlobalHydra.instance().clear()
    failed = 0
    for job in jobs:
        what, problem = job.return_value
        failed += problem is not None
        where = job.hydra_cfg.hydra.runtime.output_dir
        print(f"{what}: {' '.join(job.overrides)}: {problem or where}")
    if failed:
        raise ConfigError(f"{failed} of {len(jobs)} jobs failed")


def _folders(output: str) -> list[str]:
    """Return what tells Hydra where the jobs write: in `output`, numbered, unless it says `${...}` itself."""
    output = output.strip("'\"")
    head, sign, tail = output.partition("${")
    if not sign:
        return [f"hydra.sweep.dir='{output}'"]
    above, _, name = head.rpartition("/")
    return [f"hydra.sweep.dir='{above or '.'}'", f"hydra.sweep.subdir='{name}{sign}{tail}'"]


def _job(verb: str, _: object) -> tuple[str, str | None]:
    """Run what is left of one job of a sweep; return what was done and what stopped it: the others go on."""
    from hydra.core.global_hydra import GlobalHydra
    from hydra.core.hydra_config import HydraConfig

    from hrl_comfort.compose import compose, override
    from hrl_comfort.experiments.again import Left, left

    job = HydraConfig.get()
    folder = job.runtime.output_dir
    words = [*(str(line) for line in job.overrides.task), override("output", folder)]
    GlobalHydra.instance().clear()  # the job composes for itself, as a single run does
    try:
        config = compose(verb, words)
        assert isinstance(config, TrainConfig | EvaluateConfig)
        rest = left(config)
        if rest is not Left.NOTHING:
            RUN[verb]([override("resume", folder)] if rest is Left.REST else words)
    except Exception as error:  # noqa: BLE001  whatever it was, it is reported and the other jobs go on
        kind = "" if isinstance(error, ERRORS) else f"{type(error).__name__}: "
        return "failed", " ".join(f"{kind}{error}".split())
    return rest.value, None


def help_text() -> str:
    """Return the verbs and, by group, what can be chosen."""
    package = Path(__file__).resolve().parent
    conf = package / "conf" if (package / "conf").is_dir() else package.parent / "conf"
    lines = ["usage: hrl-comfort VERB [key=value ...] [-m]", "", "verbs"]
    lines += [f"  {verb:<10} {what}" for verb, what in VERBS.items()]
    lines += ["", "groups (group=choice)"]
    for group in sorted(p for p in conf.iterdir() if p.is_dir()):
        names = sorted(p.stem for p in group.glob("*.yaml") if p.stem[0] != "_")
        lines.append(f"  {group.name:<10} {', '.join(names)}")
    lines += [
        "",
        f"Every value in {conf} can be set: agent.decisions=50000, task.precision.take_m=0.2.",
        "-m runs every combination: hrl-comfort train -m task=pick,place train_seed=0,1",
        "output=DIR says where a command writes.",
    ]
    return "\n".join(lines)


def main(words: list[str] | None = None) -> int:
    """Run the command line `words` (default: the process's); return the exit code."""
    words = list(sys.argv[1:] if words is None else words)
    if not words or {"-h", "--help", "help"} & set(words):
        print(help_text())
        return 0
    verb, *rest = words
    try:
        if verb not in RUN:
            raise ConfigError(f"{verb} is not a verb; choose one of {', '.join(RUN)}")
        sweep = {"-m", "--multirun"} & set(rest)
        overrides = [word for word in rest if word not in ("-m", "--multirun")]
        multirun(verb, overrides) if sweep else RUN[verb](overrides)
    except ERRORS as error:
        print(f"hrl-comfort: {' '.join(str(error).split())}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("hrl-comfort: interrupted", file=sys.stderr)
        return 130
    except Preempted as stopped:
        print(f"hrl-comfort: {stopped}", file=sys.stderr)
        return 128 + signal.SIGTERM
    return 0


def console() -> None:
    """Run as the installed command."""
    warnings.formatwarning = lambda message, *_, **__: f"hrl-comfort: {message}\n"
    try:
        code = main()
        sys.stdout.flush()
    except BrokenPipeError:  # whoever read along has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    sys.exit(code)


if __name__ == "__main__":
    console()
