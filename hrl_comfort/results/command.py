"""`hrl-comfort results`: list published results, make them anew, verify them, fill the pages."""

from __future__ import annotations

from collections.abc import Callable

from rich.console import Console

from hrl_comfort.analysis.tables import in_terminal
from hrl_comfort.config import ConfigError, ResultsConfig
from hrl_comfort.results import looks, pages
from hrl_comfort.results.manifest import PHASES, Entry, entry, manifest, tracked
from hrl_comfort.results.record import read_record, state
from hrl_comfort.results.remake import remake
from hrl_comfort.results.verify import can_be_verified, verify


def results(config: ResultsConfig) -> None:
    """List results with their states; with `remake`, `verify` or `fill` do that.

    Raises:
      ConfigError: no such result, a command fails, the tree has uncommitted changes, or this is no checkout.
    """
    tracked()
    if config.remake is not None:
        for name, each in chosen("remake", config.remake, lambda _, each: each.by_hand is None):
            remake(name, each, config.train, config.jobs)
        for line in looks.merge():
            print(line)
    for name, each in chosen(
        "verify", config.verify, lambda name, each: bool(can_be_verified(each) and read_record(name))
    ):
        wrong = verify(name, each)
        if wrong:
            raise ConfigError(f"verify={name}: {wrong}")
        print(f"{name}: the same digits")
    if config.fill or config.remake is not None:
        for page in pages.fill():
            print(f"filled {page}")
    if config.name is not None:
        show(entry("name", config.name))
    elif not (config.fill or config.remake or config.verify):
        overview()


def chosen(key: str, name: str | None, fits: Callable[[str, Entry], bool]) -> list[tuple[str, Entry]]:
    """Return the entries of a key's value: one by its name, `all` that fit, or of these the `stale` ones."""
    if name is None:
        return []
    if name not in ("all", "stale"):
        return [(name, entry(key, name))]
    every = [(each, found) for each, found in manifest().items() if fits(each, found)]
    return [(each, found) for each, found in every if name == "all" or state(each, found) != "current"]


def overview() -> None:
    """Print a line for each entry, and the tracked files that belong to none."""
    lines = [[name, state(name, each), " ".join(each.pages)] for name, each in manifest().items()]
    Console().print(in_terminal(["result", "state", "pages"], [], lines))
    for path in tracked():
        if not any(each.owns(path) for each in manifest().values()):
            print(f"{path} belongs to no result of the manifest")


def show(found: Entry) -> None:
    """Print what an entry is and its commands."""
    print(found.about)
    for phase in PHASES:
        for words in found.commands(phase):
            print(f"{phase}: {' '.join(words)}")
