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

from hrl_comfort.config import ConfigError, ReportConfig
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


COMMANDS = {
    "train": ("train", "hrl_comfort.training.trainer:train"),
    "train hierarchy": ("train_hierarchy", "hrl_comfort.training.hierarchy_trainer:train_hierarchy"),
    "train meta_controller": ("train_meta_controller", "hrl_comfort.training.controller_trainer:train_meta_controller"),
    "evaluate": ("evaluate", "hrl_comfort.evaluation.evaluate:evaluate"),
    "evaluate handover": ("evaluate", "hrl_comfort.evaluation.handover:handover"),
    "report": ("report", "hrl_comfort.report.report:report"),
    "figure": ("figure", "hrl_comfort.plots.figure:figure"),
    "studio": ("studio", "hrl_comfort.studio.server:studio"),
    "bench env": ("train", "hrl_comfort.benchmarks.env:bench_env"),
    "bench update": ("train", "hrl_comfort.benchmarks.update:bench_update"),
    "bench train": ("train", "hrl_comfort.benchmarks.train:bench_train"),
}
"""Configuration of each command, and its function, imported once the configuration has been checked."""


def run(command: str, overrides: list[str]) -> None:
    """Run a command with overrides; of a hierarchy, write the report once and show its table."""
    from hrl_comfort.config.compose import compose
    from hrl_comfort.config.overrides import override

    if command == "report":  # a folder alone is its run
        overrides = [override("run", each) if Path(each).is_dir() else each for each in overrides]
    elif command == "studio":
        overrides = studio_overrides(overrides)
    root, place = COMMANDS[command]
    config = compose(root, overrides)
    others = [line for line in overrides if not line.startswith("resume=")]
    if others and getattr(config, "resume", None) is not None:
        raise ConfigError(f"resume= goes on as the run was configured; leave out {' '.join(others)}")
    module, name = place.split(":")
    result = getattr(import_module(module), name)(config)
    if command == "train hierarchy":
        show_hierarchy(result)


def show_hierarchy(folder: Path) -> None:
    """Print the table of a hierarchy and where its report is; write that once."""
    from hrl_comfort.report.report import report
    from hrl_comfort.training.hierarchy_trainer import print_table

    page = folder / "report.html"
    if not page.is_file():
        report(ReportConfig(run=str(folder), output=None, video=True))
    print_table(folder)
    print(f"report: {page}")
    print(f"watch it: hrl-comfort studio policy={folder}")


def studio_overrides(overrides: list[str]) -> list[str]:
    """Return `overrides` with the policies that the studio plays if none is named.

    Raises:
      ConfigError: viser is not installed.
    """
    try:
        import_module("hrl_comfort.studio.server")
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in ("viser", "trimesh", "websockets"):
            raise
        raise ConfigError(f"studio needs viser: pip install 'hrl-comfort[studio]' ({error})") from error
    from hrl_comfort.studio.policies import with_defaults

    return with_defaults(overrides)


RUN: dict[str, Callable[[list[str]], None]] = {command: partial(run, command) for command in COMMANDS}
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
        if verb not in RUN:
            what = overrides[0] if overrides else "(nothing)"
            known = [command.split()[1] for command in RUN if command.startswith(f"{verb} ")]
            raise ConfigError(f"{verb} {what} is not known; choose one of {', '.join(known)}")
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
