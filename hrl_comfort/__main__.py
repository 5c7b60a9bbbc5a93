"""`hrl-comfort VERB [overrides]`: the commands. Nothing heavy is imported before it is needed."""

from __future__ import annotations

import os
import signal
import sys
import warnings
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from hrl_comfort.config import (
    ConfigError,
    EvaluateConfig,
    FigureConfig,
    HierarchyTrainConfig,
    MetaControllerTrainConfig,
    ReportConfig,
    StudioConfig,
    TrainConfig,
)
from hrl_comfort.sweeps.subprocesses import ERRORS
from hrl_comfort.training.preemption import Preempted

VERBS = {
    "train": "train a policy, a cycle's policies (train hierarchy), or a controller above them (train meta_controller)",
    "evaluate": "measure a policy or a chain (meta_controller=scripted), or how policies hand over (evaluate handover)",
    "report": "write one HTML file about a run, the runs in a folder, or a sweep (run=DIR)",
    "figure": "draw what levels or controllers change (kind=levels evaluations=[DIR,...] output=FILE.png)",
    "studio": "watch a policy in the browser, walk into its cell, replay an evaluation (replay=DIR)",
    "bench": "measure the environment (env), updates (update), learning (train)",
}


def train(overrides: list[str]) -> None:
    """Run `hrl-comfort train`."""
    from hrl_comfort.config.compose import compose

    config = compose("train", overrides)
    assert isinstance(config, TrainConfig)
    _check_resumed_alone(config, overrides)
    from hrl_comfort.training.trainer import train as run

    run(config)


def train_meta_controller(overrides: list[str]) -> None:
    """Run `hrl-comfort train meta_controller`."""
    from hrl_comfort.config.compose import compose

    config = compose("train_meta_controller", overrides)
    assert isinstance(config, MetaControllerTrainConfig)
    _check_resumed_alone(config, overrides)
    from hrl_comfort.training.controller_trainer import train_meta_controller as run

    run(config)


def train_hierarchy(overrides: list[str]) -> None:
    """Run `hrl-comfort train hierarchy`; write its report once."""
    from hrl_comfort.config.compose import compose

    config = compose("train_hierarchy", overrides)
    assert isinstance(config, HierarchyTrainConfig)
    _check_resumed_alone(config, overrides)
    from hrl_comfort.training.hierarchy_trainer import is_finished, print_table
    from hrl_comfort.training.hierarchy_trainer import train_hierarchy as run

    folder = Path(config.resume or config.output)
    if is_finished(folder):
        print(f"{folder} is finished")
    run(config)
    page = folder / "report.html"
    if not page.is_file():
        from hrl_comfort.report.report import report as write

        write(ReportConfig(run=str(folder), output=None, video=True))
    print_table(folder)
    print(f"report: {page}")
    print(f"watch it: hrl-comfort studio policy={folder}")


def _check_resumed_alone(config: TrainConfig | MetaControllerTrainConfig, overrides: list[str]) -> None:
    """Raise ConfigError where a training is to go on, and otherwise than it began."""
    others = [line for line in overrides if not line.startswith("resume=")]
    if config.resume is not None and others:
        raise ConfigError(f"resume= goes on as the run was configured; leave out {' '.join(others)}")


def evaluate(overrides: list[str]) -> None:
    """Run `hrl-comfort evaluate`."""
    from hrl_comfort.config.compose import compose

    config = compose("evaluate", overrides)
    assert isinstance(config, EvaluateConfig)
    if config.terminal_states is not None:
        from hrl_comfort.evaluation.terminal_states import record_terminal_states as run
    else:
        from hrl_comfort.evaluation.evaluate import evaluate as run

    run(config)


def handover(overrides: list[str]) -> None:
    """Run `hrl-comfort evaluate handover`."""
    from hrl_comfort.config.compose import compose

    config = compose("evaluate", overrides)
    assert isinstance(config, EvaluateConfig)
    from hrl_comfort.evaluation.handover import handover as run

    run(config)


def report(overrides: list[str]) -> None:
    """Run `hrl-comfort report`; a folder alone is its run."""
    from hrl_comfort.config.compose import compose
    from hrl_comfort.config.overrides import override

    config = compose("report", [override("run", each) if Path(each).is_dir() else each for each in overrides])
    assert isinstance(config, ReportConfig)
    from hrl_comfort.report.report import report as run

    run(config)


def figure(overrides: list[str]) -> None:
    """Run `hrl-comfort figure`."""
    from hrl_comfort.config.compose import compose

    config = compose("figure", overrides)
    assert isinstance(config, FigureConfig)
    from hrl_comfort.plots.figure import figure as run

    run(config)


def studio(overrides: list[str]) -> None:
    """Run `hrl-comfort studio`."""
    from hrl_comfort.config.compose import compose

    try:
        from hrl_comfort.studio.server import studio as run
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in ("viser", "trimesh", "websockets"):
            raise
        raise ConfigError(f"studio needs viser: pip install 'hrl-comfort[studio]' ({error})") from error
    from hrl_comfort.studio.policies import with_defaults

    config = compose("studio", with_defaults(overrides))
    assert isinstance(config, StudioConfig)
    run(config)


BENCHMARKS = {
    "env": "hrl_comfort.benchmarks.env:bench_env",
    "update": "hrl_comfort.benchmarks.update:bench_update",
    "train": "hrl_comfort.benchmarks.train:bench_train",
}
"""Imported when asked for; they need the simulator, and some of them peers."""


def bench(words: list[str]) -> None:
    """Run one of the benchmarks."""
    if not words or words[0] not in BENCHMARKS:
        what = words[0] if words else "(nothing)"
        raise ConfigError(f"bench {what} is not known; choose one of {', '.join(BENCHMARKS)}")
    from hrl_comfort.config.compose import compose

    config = compose("train", words[1:])
    assert isinstance(config, TrainConfig)
    module, name = BENCHMARKS[words[0]].split(":")
    getattr(import_module(module), name)(config)


RUN: dict[str, Callable[[list[str]], None]] = {
    "train": train,
    "train hierarchy": train_hierarchy,
    "train meta_controller": train_meta_controller,
    "evaluate": evaluate,
    "evaluate handover": handover,
    "report": report,
    "figure": figure,
    "studio": studio,
    "bench": bench,
}
"""Function of each verb, alone or with the word after it."""
SWEPT = ("train", "train hierarchy", "train meta_controller", "evaluate")


def sweep(verb: str, overrides: list[str]) -> None:
    """Run `verb` once for every combination of the swept overrides.

    What runs the jobs takes seconds to import: it is imported once every choice has been checked.
    """
    if verb not in SWEPT:
        raise ConfigError(f"{verb} cannot be swept; -m goes with {', '.join(SWEPT)}")
    if any(line.lstrip("+").split("=")[0] == "resume" for line in overrides):
        raise ConfigError("resume does not go with -m: give one run at a time")
    from hrl_comfort.config.overrides import check_overrides, root_of

    outputs = [line.split("=", 1)[1] for line in overrides if line.startswith("output=")]
    rest = [line for line in overrides if not line.startswith("output=")]
    checked = check_overrides(root_of(verb), rest, sweep=True)
    from hrl_comfort.sweeps.launcher import multirun

    multirun(verb, RUN[verb], checked, outputs)


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
        f"Every value in {conf} can be set: agent.policy_steps=50000, task.precision.grasp_tolerance_m=0.2.",
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
        if verb not in VERBS:
            raise ConfigError(f"{verb} is not a verb; choose one of {', '.join(VERBS)}")
        swept = {"-m", "--multirun"} & set(rest)
        overrides = [word for word in rest if word not in ("-m", "--multirun")]
        if overrides and f"{verb} {overrides[0]}" in RUN:
            verb, overrides = f"{verb} {overrides[0]}", overrides[1:]
        sweep(verb, overrides) if swept else RUN[verb](overrides)
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
    os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")  # TorchRL reports on every buffer that it allocates
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
