"""The page about a sweep: one table, one figure, and every job that is not finished, with its reason.

Beside the page lie the table as CSV and as Markdown, and the figure as PNG, by the page's name.
"""

from __future__ import annotations

import shlex
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup
from rich.console import Console
from rich.table import Table

from hrl_comfort.analysis.sweeps import QUANTITIES, Sweep, as_csv, not_finished, read_sweep, table
from hrl_comfort.analysis.tables import cells, in_terminal, markdown
from hrl_comfort.config import ConfigError
from hrl_comfort.files.atomic import all_or_none, write_text
from hrl_comfort.files.output import output_file
from hrl_comfort.plots.style import data_uri, save_png
from hrl_comfort.plots.sweeps import LOOKS, learning

BESIDE = (".csv", ".md", ".png")
"""Suffixes of the files beside the page."""
HEADS = ["folder", "overrides", "state", "why"]


def render(template: str, **values: Any) -> str:
    """Return a page of this package's templates."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("hrl_comfort", "report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    style = resources.files("hrl_comfort.report").joinpath("report.css").read_text(encoding="utf-8")
    return environment.get_template(template).render(style=Markup(style), **values)


def sweep_report(folder: Path, output: Path) -> bool:
    """Write the page about the sweep in `folder`; return whether there is one.

    Raises:
      ConfigError: a file of the sweep is damaged, or `output` would overwrite the table.
    """
    sweep = read_sweep(folder)
    if not sweep.rows:
        return False
    if output.suffix in BESIDE:
        raise ConfigError(f"output={str(output)!r} is the page; its {output.suffix} file is written beside it")
    with output_file(output, *BESIDE), all_or_none():
        _write(sweep, folder, output)
    Console().print(_printed(sweep))
    return True


def _printed(sweep: Sweep) -> Table:
    """Return the table for the terminal: the evaluated success first, then the score of the trainings."""
    names = ("eval_success", "eval_precision_m", sweep.curve.score if sweep.curve else "", "precision_m")
    there = {name: QUANTITIES[name] for name in names if any(name in row.means for row in sweep.rows)}
    lines = []
    for row in sweep.rows:
        finished = f"{row.counts['finished']}/{len(row.entries)}"
        lines.append([*(row.combination.values() or ["all runs"]), finished, *cells(row.means, there)])
    labels = list(sweep.rows[0].combination) or ["combination"]
    return in_terminal(labels, ["finished", *(each.label for each in there.values())], lines)


def _write(sweep: Sweep, folder: Path, output: Path) -> None:
    figure = learning(sweep)
    write_text(output.with_suffix(".csv"), as_csv(sweep))
    write_text(output.with_suffix(".md"), _markdown(sweep))
    if figure is not None:
        save_png(figure, output.with_suffix(".png"))
    heads, lines = table(sweep)
    page = render(
        "sweep.html.j2",
        title=folder.resolve().name,
        evaluate=f"hrl-comfort evaluate -m {shlex.quote(str(folder))}/*/ split=validation",
        here=Path.cwd(),
        alike=sweep.alike,
        words=len(heads) if not sweep.rows[0].combination else len(sweep.rows[0].combination),
        heads=heads,
        lines=lines,
        problem_heads=HEADS,
        problems=not_finished(sweep),
        jobs=len(sweep.entries),
        others=_others(folder, sweep),
        figure=None if figure is None else data_uri(figure),
        curve=sweep.curve,
        left_out=max(0, len(sweep.rows) - len(LOOKS)),
    )
    write_text(output, page)


def _markdown(sweep: Sweep) -> str:
    """Return both tables in Markdown."""
    text = markdown(*table(sweep))
    problems = not_finished(sweep)
    return text + ("\n" + markdown(HEADS, problems) if problems else "")


def _others(folder: Path, sweep: Sweep) -> list[str]:
    """Return the run folders beside the sweep's own."""
    own = {entry.where.split("/")[0] for entry in sweep.entries}
    return sorted(file.parent.name for file in folder.glob("*/config.yaml") if file.parent.name not in own)
