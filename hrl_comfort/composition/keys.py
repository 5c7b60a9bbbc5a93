"""Keys of the configurations, described by the fields' docstrings and types."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Iterator
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from hrl_comfort.config import checks
from hrl_comfort.config.hierarchy import TOP_LEARNERS
from hrl_comfort.config.hydra_conf import values_of
from hrl_comfort.config.learning import LEARNERS
from hrl_comfort.config.overrides import ROOTS

MOST = 40
"""Longest default, characters, that is shown."""
OWN: dict[str, dict[str, type]] = {"agent.own": LEARNERS, "meta_controller_agent.own": TOP_LEARNERS}
"""Dataclasses of the keys that some parts alone have, by key and name of the part."""


@dataclass(frozen=True)
class Key:
    """A key of a configuration, each field as text."""

    name: str
    """With the names of its sections: `task.precision.grasp_tolerance_m`."""
    meaning: str
    allowed: str
    default: str
    """As on the command line; empty without one, … where it is long."""
    hint: Any = None
    """Type of its value, with its checks."""

    @property
    def of_entry(self) -> bool:
        """Whether it stands for a key of each entry of a list (`[]`) or mapping (`NAME`), or of some parts alone."""
        return "[]" in self.name or ".NAME." in self.name or ".own." in self.name

    @property
    def section(self) -> str:
        """The first part of the name; empty for a key of the command."""
        return self.name.partition(".")[0] if "." in self.name else ""


@cache
def keys_of(root: str) -> tuple[Key, ...]:
    """Return the keys of a configuration of ROOTS, with the defaults of its command without overrides."""
    return tuple(_keys(ROOTS[root], values_of(root), ""))


def _keys(kind: Any, values: Any, before: str) -> Iterator[Key]:
    """Yield the keys of a dataclass; those of fields that are dataclasses follow with dotted names."""
    meanings, hints = docstrings(kind), get_type_hints(kind, include_extras=True)
    for field in fields(kind):
        name, hint = f"{before}{field.name}", hints[field.name]
        own = {} if field.default is MISSING else {field.name: field.default}
        own |= {} if field.default_factory is MISSING else {field.name: field.default_factory()}
        given = values or own
        if is_dataclass(hint):
            yield from _keys(hint, given[field.name], f"{name}.")
            continue
        default = shown(given[field.name]) if field.name in given else ""
        yield Key(name, meanings.get(field.name, ""), allowed(hint), default, hint)
        for part, keys in OWN.get(name, {}).items():
            for key in _keys(keys, {}, f"{name}."):
                yield replace(key, meaning=f"`{part}`: {key.meaning}")
        inner = get_args(hint)[0] if get_origin(hint) is Annotated else hint
        if get_origin(inner) is list and is_dataclass(entry := get_args(inner)[0]):
            yield from _keys(entry, None, f"{name}[].")
        if get_origin(inner) is dict and is_dataclass(entry := get_args(inner)[1]):
            yield from _keys(entry, None, f"{name}.NAME.")


def docstrings(kind: type) -> dict[str, str]:
    """Return the docstring below each field of a dataclass and of those it extends."""
    found: dict[str, str] = {}
    for cls in reversed([each for each in kind.__mro__ if is_dataclass(each)]):
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(cls))).body
        assert isinstance(tree, ast.ClassDef)
        for here, after in pairwise(tree.body):
            match here, after:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                    found[name] = " ".join(text.split())
    return found


def choices_of(hint: Any) -> tuple[str, ...]:
    """Return the only values that a field may have; none where it may have others."""
    checks_of = [getattr(getattr(check, "func", None), "keywords", {}) for check in getattr(hint, "__metadata__", ())]
    return next((tuple(each["names"]) for each in checks_of if "names" in each and "key" not in each), ())


def allowed(hint: Any) -> str:
    """Return what the checks of a field's type allow."""
    said = []
    optional = [each for each in get_args(hint) if get_origin(each) is Annotated]
    for check in getattr(optional[0] if optional else hint, "__metadata__", ()):
        keywords = getattr(getattr(check, "func", None), "keywords", {})
        if "low" in keywords:
            low, high = keywords["low"], keywords["high"]
            said.append(f"from {low:g}" if high > 1e9 else f"{low:g} to {high:g}")
        elif "numbers" in keywords:
            said.append(", ".join(map(str, keywords["numbers"])))
        elif "names" in keywords:
            names = (*keywords["names"], *(["package.module:name"] if "key" in keywords else []))
            said.append(", ".join(f"`{name}`" for name in names))
        elif hint in (checks.XY, checks.XYZ):
            said.append(f"{check.metadata[0].min_length} numbers")
    return "; ".join(said)


def shown(default: Any) -> str:
    """Return a default value as it is written on the command line."""
    if default == "???":
        return ""
    if isinstance(default, float):
        return f"{default:g}"
    text = {"None": "null", "True": "true", "False": "false"}.get(str(default), str(default))
    text = re.sub(r"\d{4}-\d\d-\d\d_[\d-]+", "DATE", text.replace("'", "").replace(" ", ""))
    return text if len(text) <= MOST else "…"
