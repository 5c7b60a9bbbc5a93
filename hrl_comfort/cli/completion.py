"""Completion of commands, groups, choices and keys in the shell, by argcomplete."""

from __future__ import annotations

import argparse
import os
from typing import Any

from hrl_comfort.cli.commands import COMMANDS, VERBS, parts_of
from hrl_comfort.composition.keys import keys_of
from hrl_comfort.config.overrides import groups, root_of


def complete() -> None:
    """Answer the shell and end the process, if it is the shell that called."""
    if "_ARGCOMPLETE" not in os.environ:
        return
    import argcomplete

    parser = argparse.ArgumentParser(prog="hrl-comfort", add_help=False)
    for option in ("--help", "--version", "--dry-run", "--multirun", "--overwrite"):
        parser.add_argument(option, action="store_true")
    words: Any = parser.add_argument("words", nargs="*")
    words.completer = lambda prefix, parsed_args, **_: candidates(parsed_args.words or [], prefix)
    argcomplete.autocomplete(parser)


def candidates(words: list[str], prefix: str) -> list[str]:
    """Return what may follow the complete `words`, as far as it begins with `prefix`."""
    if not words:
        return [verb for verb in (*VERBS, "doctor") if verb.startswith(prefix)]
    command = next((each for each in (" ".join(words[:2]), words[0]) if each in COMMANDS), None)
    found = list(parts_of(words[0])) if len(words) == 1 else []
    if command is not None:
        root = root_of(command)
        choices = groups(root)
        found += [f"{key.name}=" for key in keys_of(root)] + [f"{group}=" for group in choices]
        found += [f"{group}={name}" for group, names in choices.items() for name in names if f"{group}=" in prefix]
    return [each for each in found if each.startswith(prefix)]
