"""Fill the tables of docs/reproduce.md from the committed evaluations: `python docs/tables.py`.

A table stands between `<!-- evaluations: FOLDER ... -->` and `<!-- end -->`. Folders are those of
evaluations in runs/reference; one with a `*` pools the episodes of all that match (say, of three training
seeds). With `--check` nothing is written, and the exit code says whether the page is up to date.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from hrl_comfort.experiments.statistics import LABELS, Row, group_metrics, read_rows

ROOT = Path(__file__).resolve().parent.parent
PAGE, REFERENCE = ROOT / "docs" / "reproduce.md", ROOT / "runs" / "reference"
MARKED = re.compile(r"(<!-- evaluations: ([^>]*?) -->\n).*?(<!-- end -->)", re.DOTALL)
LIMIT_STEPS = 500  # only `steps_all`, not shown, depends on it
COLUMNS = (
    "evaluation", "episodes", "success, % [95 %]", "on seen spawns", "on unseen spawns", "steps",
    "human distance, m", "human hit, %", "cell or self hit, %",
)  # fmt: skip


def table(folders: list[str]) -> str:
    """Return the Markdown table of evaluations, one line each."""
    head = f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|\n"
    return head + "".join(line(name) for name in folders)


def line(name: str) -> str:
    """Return the line of one evaluation, or of the pooled episodes of those that match."""
    found = sorted(REFERENCE.glob(f"{name}/episodes.csv"))
    if not found:
        raise FileNotFoundError(f"no runs/reference/{name}/episodes.csv")
    rows = [row for path in found for row in read_rows(path)]
    metrics = group_metrics(rows, LABELS, LIMIT_STEPS)
    cells = [name.removesuffix("/eval"), str(len(rows)), share(rows, interval=True)]
    cells += [share([row for row in rows if row["seen"] == flag]) for flag in ("True", "False")]
    for metric, form in (("steps", "{:.0f}"), ("human_distance_mean_m", "{:.3f}")):
        cells.append(form.format(metrics[metric]["mean"]) if metric in metrics else "–")
    cells += [f"{100 * metrics[metric]['mean']:.1f}" for metric in ("human_collision", "other_collision")]
    return "| " + " | ".join(cells) + " |\n"


def share(rows: list[Row], interval: bool = False) -> str:
    """Return the share of successful episodes in percent."""
    success = group_metrics(rows, LABELS, LIMIT_STEPS)["success"]
    low, high = success["ci95"]
    text = f"{100 * success['mean']:.1f}"
    return f"{text} [{100 * low:.1f}, {100 * high:.1f}]" if interval else text


def filled(page: str) -> str:
    """Return the page with every marked table made anew."""
    return MARKED.sub(lambda found: found[1] + table(found[2].split()) + found[3], page)


if __name__ == "__main__":
    before = PAGE.read_text(encoding="utf-8")
    after = filled(before)
    if "--check" in sys.argv:
        sys.exit(f"{PAGE}: run `python docs/tables.py`" if after != before else 0)
    PAGE.write_text(after, encoding="utf-8")
