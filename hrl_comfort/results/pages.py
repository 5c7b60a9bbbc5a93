"""Filling the pages: tables between `<!-- KIND: NAMES -->` and `<!-- end -->`, and single cells of them in prose.

A number in prose is a cell of a table: `<!-- cell: KIND: NAMES :: ROW :: COLUMN -->1.5<!-- end -->`. ROW is how the row
begins, its first cells separated by `::`; COLUMN is the head of the column. A number that is no result stands between
`<!-- given -->` and `<!-- end -->`.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from hrl_comfort.config import ConfigError
from hrl_comfort.files.atomic import write_text
from hrl_comfort.files.provenance import ROOT
from hrl_comfort.results.tables import KINDS

ABSENT = "*Not measured yet: `hrl-comfort results` says what is missing.*\n"
KIND = "|".join(sorted(KINDS, key=len, reverse=True))
TABLE = re.compile(rf"(<!-- ({KIND}): ([^>]*?) -->\n).*?(<!-- end -->)", re.DOTALL)
CELL = re.compile(rf"(<!-- cell: ({KIND}): ([^>]*?) -->).*?(<!-- end -->)", re.DOTALL)


@cache
def table(kind: str, names: str) -> str:
    """Return a table, or a line that says that it is not measured yet."""
    try:
        return KINDS[kind](names)
    except FileNotFoundError:
        return ABSENT


def cell(kind: str, asked: str) -> str:
    """Return the cell that `NAMES :: ROW :: COLUMN` asks for; raise ConfigError if the table has none."""
    names, *row, column = (part.strip() for part in asked.split("::"))
    made = table(kind, names)
    if made == ABSENT:
        return "–"
    head, _, *rows = ([each.strip() for each in line.strip().strip("|").split("|")] for line in made.splitlines())
    found = [each for each in rows if each[: len(row)] == row]
    if len(found) != 1 or column not in head:
        raise ConfigError(f"cell: {kind}: {asked}: {len(found)} rows begin so; columns are {', '.join(head)}")
    return found[0][head.index(column)]


def filled(page: str) -> str:
    """Return the text of a page with its tables and cells made anew."""
    page = TABLE.sub(lambda found: found[1] + table(found[2], found[3]) + found[4], page)
    return CELL.sub(lambda found: found[1] + cell(found[2], found[3]) + found[4], page)


def pages() -> list[Path]:
    """Return the pages of the checkout, README.md and those of docs/."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def fill() -> list[Path]:
    """Fill every page; return those that changed."""
    table.cache_clear()
    changed = []
    for page in pages():
        before = page.read_text(encoding="utf-8")
        if (after := filled(before)) != before:
            write_text(page, after)
            changed.append(page)
    return changed
