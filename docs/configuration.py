"""Fill the tables of docs/configuration.md from the configuration's dataclasses: `python docs/configuration.py`.

A table stands between `<!-- keys: NAME -->` and `<!-- end -->`. NAME is a section of the configuration, such as
`human`, or a command, whose own keys are then listed. Meanings are the fields' docstrings.
"""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Iterator
from dataclasses import MISSING, Field, fields, is_dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from hrl_comfort.config import checks
from hrl_comfort.config.compose import compose

PAGE = Path(__file__).resolve().parent / "configuration.md"
COMMANDS = {
    "train": compose("train"),
    "train hierarchy": compose("train_hierarchy"),
    "train meta_controller": compose("train_meta_controller"),
    "evaluate": compose("evaluate"),
    "studio": compose("studio"),
    "report": compose("report", ["run=RUN"]),
    "figure": compose("figure", ["kind=levels", "evaluations=[RUN]", "output=FILE.png"]),
}
HEAD = "| key | meaning | allowed | default |\n|---|---|---|---|\n"
MARKED = re.compile(r"(<!-- keys: ([^>]*?) -->\n).*?(<!-- end -->)", re.DOTALL)


def table(name: str) -> str:
    """Return the Markdown table of a section or of a command's own keys."""
    if name in COMMANDS:
        return HEAD + "".join(lines(type(COMMANDS[name]), COMMANDS[name], "", nested=False))
    root = next(each for each in COMMANDS.values() if hasattr(each, name))
    section = getattr(root, name)
    return HEAD + "".join(lines(type(section), section, "", nested=True))


def lines(kind: type, value: Any, before: str, nested: bool) -> Iterator[str]:
    """Yield a line for each field of a dataclass; fields that are dataclasses follow with dotted keys."""
    meanings, hints = docstrings(kind), get_type_hints(kind, include_extras=True)
    for field in fields(kind):
        default = getattr(value, field.name) if value is not None else _default(field)
        if is_dataclass(default):
            yield from lines(type(default), default, f"{before}{field.name}.", nested) if nested else ()
            continue
        cells = (f"`{before}{field.name}`", meanings.get(field.name, ""), allowed(hints[field.name]), shown(default))
        yield f"| {' | '.join(cells)} |\n"
        entry = getattr(hints[field.name], "__args__", (None,))[0]
        if is_dataclass(entry) and isinstance(entry, type):
            yield from lines(entry, None, f"{before}{field.name}[].", nested)


def docstrings(kind: type) -> dict[str, str]:
    """Return the docstring below each field of a dataclass and of those it extends."""
    found: dict[str, str] = {}
    for cls in reversed([each for each in kind.__mro__ if is_dataclass(each)]):
        body = ast.parse(textwrap.dedent(inspect.getsource(cls))).body[0].body  # type: ignore[attr-defined]
        for here, after in pairwise(body):
            if (
                isinstance(here, ast.AnnAssign)
                and isinstance(after, ast.Expr)
                and isinstance(after.value, ast.Constant)
            ):
                found[here.target.id] = " ".join(str(after.value.value).split())  # type: ignore[union-attr]
    return found


def allowed(hint: Any) -> str:
    """Return what the checks of a field's type allow."""
    said = []
    optional = [each for each in get_args(hint) if get_origin(each) is Annotated]
    for check in getattr(optional[0] if optional else hint, "__metadata__", ()):
        keywords = getattr(getattr(check, "func", None), "keywords", {})
        if "low" in keywords:
            low, high = keywords["low"], keywords["high"]
            said.append(f"from {low:g}" if high > 1e9 else f"{low:g} to {high:g}")
        elif "names" in keywords:
            names = (*keywords["names"], *(["package.module:name"] if "key" in keywords else []))
            said.append(", ".join(f"`{name}`" for name in names))
        elif hint in (checks.XY, checks.XYZ, checks.JointAngles):
            said.append(f"{check.metadata[0].min_length} numbers")
    return "; ".join(said)


def shown(default: Any) -> str:
    """Return a default value as it is written on the command line."""
    if default is _NONE:
        return ""
    if isinstance(default, float):
        return f"`{default:g}`"
    text = {"None": "null", "True": "true", "False": "false"}.get(str(default), str(default))
    text = re.sub(r"\d{4}-\d\d-\d\d_[\d-]+", "DATE", text.replace("'", "").replace(" ", ""))
    return f"`{text}`" if len(text) <= 40 else "…"


_NONE = object()


def _default(field: Field[Any]) -> Any:
    return field.default if field.default is not MISSING else _NONE


def filled(page: str) -> str:
    """Return the page with every marked table made anew."""
    return MARKED.sub(lambda found: found[1] + table(found[2]) + found[3], page)


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
