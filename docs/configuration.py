"""Fill the tables of docs/configuration.md from the configuration's dataclasses: `python docs/configuration.py`.

A table stands between `<!-- keys: NAME -->` and `<!-- end -->`. NAME is a section of the configuration, such as
`human`, or a command, whose own keys are then listed. Meanings are the fields' docstrings.
"""

from __future__ import annotations

import re
from pathlib import Path

from hrl_comfort.config.command_line.keys import Key, keys_of
from hrl_comfort.config.overrides import ROOTS, root_of

PAGE = Path(__file__).resolve().parent / "configuration.md"
CONF = PAGE.parent.parent / "conf"
HEAD = "| key | meaning | allowed | default |\n|---|---|---|---|\n"
SHORT = ("deploy", "studio")
"""Commands whose tables leave out the keys that they share with `evaluate`."""
MARKED = re.compile(r"(<!-- keys: ([^>]*?) -->\n).*?(<!-- end -->)", re.DOTALL)


def table(name: str) -> str:
    """Return the table of a section, or of a command's own keys; in SHORT without those that `evaluate` has alike."""
    if (root := root_of(name)) in ROOTS:
        lines = [_line(key, key.name, root) for key in keys_of(root) if not key.section]
        alike = {_line(key, key.name, "evaluate") for key in keys_of("evaluate")} if root in SHORT else set()
        return HEAD + "".join(line for line in lines if line not in alike)
    root = next(root for root in ROOTS if any(key.section == name for key in keys_of(root)))
    keys = [key for key in keys_of(root) if key.section == name]
    return HEAD + "".join(_line(key, key.name.removeprefix(f"{name}."), root) for key in keys)


def _line(key: Key, name: str, root: str) -> str:
    default = _file_of(key, root) if key.default == "…" else f"`{key.default}`" if key.default else ""
    return f"| `{name}` | {key.meaning} | {key.allowed} | {default} |\n"


def _file_of(key: Key, root: str) -> str:
    """Return a link to the file of `conf/` that holds a default too long for the table."""
    line = re.compile(rf"^ *{key.name.rpartition('.')[2]}:", re.MULTILINE)
    files = [*sorted((CONF / key.section).glob("*.yaml")), CONF / f"{root}.yaml"]
    file = next(each for each in files if line.search(each.read_text(encoding="utf-8")))
    return f"[{file.name}](../{file.relative_to(CONF.parent)})"


def filled(page: str) -> str:
    """Return the page with every marked table made anew."""
    return MARKED.sub(lambda found: found[1] + table(found[2]) + found[3], page)


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
