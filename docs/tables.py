"""Print the table of docs/reproduce.md, Markdown, from the committed summaries: `python docs/tables.py`."""

from __future__ import annotations

import json
from pathlib import Path

REFERENCE = Path(__file__).resolve().parent.parent / "runs" / "reference"
COLUMNS = ("success", "steps", "human_distance_mean_m", "human_collision", "other_collision")


def rows(folder: Path) -> list[str]:
    """Return one line a group of the summary in `folder`."""
    lines = []
    for group in json.loads((folder / "summary.json").read_text(encoding="utf-8"))["groups"]:
        metrics = group["metrics"]
        spawns = {True: "seen", False: "unseen"}.get(group.get("seen"), "all")
        low, high = metrics["success"]["ci95"]
        cells = [
            str(folder.relative_to(REFERENCE)),
            group["human"],
            f"{100 * group['precision_m']:g}",
            spawns,
            str(group["episodes"]),
            f"{metrics['success']['mean']:.1%} [{low:.1%}, {high:.1%}]",
            *(f"{metrics[name]['mean']:.3g}" if name in metrics else "–" for name in COLUMNS[1:]),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


if __name__ == "__main__":
    names = ["evaluation", "human", "precision, cm", "spawns", "episodes", "success [95 %]", "steps"]
    names += ["human distance, m", "human collisions", "other collisions"]
    print("| " + " | ".join(names) + " |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for summary in sorted(REFERENCE.rglob("summary.json")):
        if "endings" not in summary.parts and "checkpoints" not in summary.parts:
            print("\n".join(rows(summary.parent)))
