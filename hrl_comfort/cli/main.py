"""`hrl-comfort VERB [overrides]`: the commands. Nothing heavy is imported before it is needed."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path

from hrl_comfort import __version__
from hrl_comfort.cli import help as help_texts
from hrl_comfort.cli.commands import COMMANDS, VERBS, parts_of
from hrl_comfort.cli.first_checks import BARE, check, completed
from hrl_comfort.composition.compose import compose
from hrl_comfort.composition.own_files import with_own_files
from hrl_comfort.config import ConfigError, ReportConfig
from hrl_comfort.config.commands import CommandConfig
from hrl_comfort.config.overrides import at_home, check_overrides, near, root_of
from hrl_comfort.deploy.stops import StoppedError
from hrl_comfort.files.atomic import OVERWRITE
from hrl_comfort.files.run_config import yaml_of
from hrl_comfort.sweeps.subprocesses import ERRORS
from hrl_comfort.training.preemption import Preempted

FLAGS = ("-h", "--help", "--version", "--dry-run", "-m", "--multirun", "--overwrite")


def configuration(command: str, overrides: list[str]) -> CommandConfig:
    """Return the configuration of a command.

    Raises:
      ConfigError: a choice is not allowed.
    """
    given, overrides = overrides, completed(command, overrides)
    config = compose(root_of(command), overrides)
    others = [line for line in given if not line.startswith("resume=")]
    if others and getattr(config, "resume", None) is not None:
        raise ConfigError(f"resume= goes on as the run was configured; leave out {' '.join(others)}")
    check(config)
    return config


def run(command: str, overrides: list[str]) -> None:
    """Run a command with overrides; of a hierarchy, write the report once and show its table."""
    config = configuration(command, overrides)
    module, name = COMMANDS[command].place.split(":")
    result = getattr(import_module(module), name)(config)
    if command == "train hierarchy":
        show_hierarchy(result)


def show_hierarchy(folder: Path) -> None:
    """Print the table of a hierarchy and the path of its report; write that once."""
    from hrl_comfort.report.report import report
    from hrl_comfort.training.hierarchy_trainer import print_table

    page = folder / "report.html"
    if page.is_file():
        print_table(folder)
        print(page)
    else:
        report(ReportConfig(run=str(folder), output=None, video=True))
    print(f"watch it: hrl-comfort studio policy={folder}")


RUN: dict[str, Callable[[list[str]], None]] = {command: partial(run, command) for command in COMMANDS}
LONGEST = 1000
"""Characters of an error of which nothing is left out."""
SWEPT = ("train", "train hierarchy", "train meta_controller", "evaluate")


def sweep(command: str, overrides: list[str]) -> None:
    """Run a command once for every combination of the swept overrides.

    What runs the jobs takes seconds to import: it is imported once every choice has been checked.
    """
    if command not in SWEPT:
        raise ConfigError(f"{command} cannot be swept; -m goes with {', '.join(SWEPT)}")
    if any(line.lstrip("+").split("=")[0] == "resume" for line in overrides):
        raise ConfigError("resume does not go with -m: give one run at a time")
    outputs = [line.split("=", 1)[1] for line in overrides if line.startswith("output=")]
    rest = completed(command, [line for line in overrides if not line.startswith("output=")], sweep=True)
    checked = check_overrides(root_of(command), with_own_files(rest), sweep=True)
    from hrl_comfort.sweeps.launcher import multirun

    multirun(command, RUN[command], checked, outputs)


def command_of(words: list[str]) -> tuple[str, list[str]]:
    """Return the command that `words` begin with, and the other words.

    Raises:
      ConfigError: there is none.
    """
    verb, *rest = words
    if verb not in VERBS:
        raise ConfigError(f"{verb} is not a verb{near(verb, VERBS)}; choose one of {', '.join(VERBS)}")
    if rest and f"{verb} {rest[0]}" in RUN:
        return f"{verb} {rest[0]}", rest[1:]
    parts, what = parts_of(verb), rest[0] if rest else "(nothing)"
    if verb not in RUN or (parts and verb not in BARE and what.isidentifier()):
        alone = "" if verb not in RUN else ", or give key=value"
        raise ConfigError(f"{verb} {what} is not known{near(what, parts)}; choose one of {', '.join(parts)}{alone}")
    return verb, rest


def execute(words: list[str]) -> None:
    """Do what the command line asks for."""
    flags, rest = set(words) & set(FLAGS), [at_home(word) for word in words if word not in FLAGS]
    if "--overwrite" in flags:
        os.environ[OVERWRITE] = "1"
    asked, swept = bool(flags & {"-h", "--help"}), bool(flags & {"-m", "--multirun"})
    if "--version" in flags:
        print(f"hrl-comfort {__version__}")
    elif rest == ["doctor"]:
        from hrl_comfort.cli import doctor

        print(doctor.report(), end="")
    elif not rest or rest == ["help"] or (asked and rest[0] in VERBS and rest[0] not in RUN and len(rest) == 1):
        print(help_texts.overview())
    elif asked:
        print(help_texts.about(command_of(rest)[0]))
    elif swept and "--dry-run" in flags:
        raise ConfigError("--dry-run does not go with -m: give one run at a time")
    elif swept:
        sweep(*command_of(rest))
    elif "--dry-run" in flags:
        print(yaml_of(configuration(*command_of(rest))), end="")
    else:
        command, overrides = command_of(rest)
        RUN[command](overrides)


def main(words: list[str] | None = None) -> int:
    """Run the command line `words` (default: the process's); return the exit code."""
    try:
        execute(list(sys.argv[1:] if words is None else words))
    except ERRORS as error:
        line = " ".join(str(error).split()) or "out of memory"
        if len(line) > LONGEST:
            line = f"{line[: LONGEST // 2]} … {line[-LONGEST // 2 :]}"
        print(f"hrl-comfort: {line}", file=sys.stderr)
        return 1
    except StoppedError as stopped:
        print(f"hrl-comfort: stopped: {stopped}", file=sys.stderr)
        return stopped.code
    except KeyboardInterrupt:
        print("hrl-comfort: interrupted", file=sys.stderr)
        return 130
    except Preempted as stopped:
        print(f"hrl-comfort: {stopped}", file=sys.stderr)
        return 128 + signal.SIGTERM
    finally:
        os.environ.pop(OVERWRITE, None)
    return 0
