"""Help texts: all commands, or the keys, choices and an example of one."""

from __future__ import annotations

import textwrap
from itertools import groupby

from omegaconf import DictConfig, OmegaConf

from hrl_comfort.cli.commands import COMMANDS
from hrl_comfort.composition.keys import Key, keys_of
from hrl_comfort.config.overrides import config_dir, groups, root_of

WIDTH = 80
OPTIONS = {
    "-h, --help": "this text, or that of the command before it",
    "--version": "the version",
    "--dry-run": "print the resolved configuration, do nothing else",
    "-m, --multirun": "run every combination: train -m task=pick,place train_seed=0,1",
    "--overwrite": "replace files in output= that this command did not write",
}


def overview() -> str:
    """Return the help of all commands."""
    lines = ["usage: hrl-comfort COMMAND [key=value ...] [-m] [--dry-run]", "", "commands"]
    lines += [f"  {command:<22}{each.about}" for command, each in COMMANDS.items()]
    lines += [f"  {'doctor':<22}list versions, extras and what is missing, for an issue"]
    lines += ["", "options", *(f"  {name:<22}{about}" for name, about in OPTIONS.items()), ""]
    lines += ["hrl-comfort COMMAND --help lists a command's choices, keys and defaults."]
    lines += ['Completion in bash and zsh: eval "$(register-python-argcomplete hrl-comfort)"']
    return _wrapped(lines)


def about(command: str) -> str:
    """Return the help of one of COMMANDS."""
    own, root = COMMANDS[command], root_of(command)
    keys = keys_of(root)
    lines = [f"usage: hrl-comfort {command} [key=value ...]", "", f"{own.about[0].upper()}{own.about[1:]}.", ""]
    lines += ["example", f"  hrl-comfort {command} {own.example}"]
    if choices := groups(root):
        lines += ["", "groups (group=choice, the default first)"]
        lines += [f"  {name:<22}{', '.join(default_first(root, name))}" for name in choices]
    for section, each in groupby(sorted(keys, key=lambda key: key.section), lambda key: key.section):
        lines += ["", f"keys of {section or 'the command'} (key=default)"]
        lines += [line for key in each for line in _key(key)]
    return _wrapped(lines)


def default_first(root: str, group: str) -> list[str]:
    """Return the choices of a group, that of `conf/ROOT.yaml` first."""
    entries = OmegaConf.load(config_dir() / f"{root}.yaml").defaults
    default = next(entry[group] for entry in entries if isinstance(entry, DictConfig) and group in entry)
    return sorted(groups(root)[group], key=lambda name: name != default)


def _key(key: Key) -> list[str]:
    allowed = f" ({key.allowed.replace('`', '')})" if key.allowed else ""
    value = f"={key.default}" if key.default else " (required)"
    return [f"  {key.name}{value}", f"      {key.meaning}{allowed}"]


def _wrapped(lines: list[str]) -> str:
    """Return lines of at most WIDTH characters; a line goes on below its second column."""
    found = []
    for line in lines:
        column = 24 if line.startswith("  ") and not line.startswith("   ") else len(line) - len(line.lstrip())
        found += textwrap.wrap(line, WIDTH, subsequent_indent=" " * column, break_long_words=False) or [""]
    return "\n".join(found)
