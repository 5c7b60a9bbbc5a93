"""The docs hold: tables come from the committed results, commands name what exists."""

from __future__ import annotations

import re
import runpy
import shlex
from pathlib import Path

import pytest

from hrl_comfort.comfort import sources, terms
from hrl_comfort.config.overrides import check_overrides
from hrl_comfort.evaluation.episode import COLUMNS

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
OVERLAYS = sorted((ROOT / "conf" / "experiment").glob("*.yaml"))


@pytest.mark.parametrize("overlay", OVERLAYS, ids=lambda path: path.stem)
def test_the_commands_on_top_of_an_overlay_are_accepted(overlay: Path) -> None:
    lines = re.findall(r"^#\s+(hrl-comfort .*)$", overlay.read_text(encoding="utf-8"), re.MULTILINE)
    for line in lines:
        _, verb, *words = shlex.split(line, comments=True)
        root = "train_hierarchy" if words[0] == "hierarchy" else verb
        overrides = [word for word in words if word not in ("-m", "hierarchy")]
        assert check_overrides(root, overrides, sweep="-m" in words), line


def test_comfort_has_a_command_for_every_source_and_a_word_on_every_form() -> None:
    text = (ROOT / "docs" / "comfort.md").read_text(encoding="utf-8")
    for name in sources.SOURCES:
        assert f"comfort.source={name}" in text or name == "none", name
    for name in (*sources.SOURCES, *terms.FORMS, *terms.THRESHOLDS, *terms.SPEED_FORMS):
        assert f"`{name}`" in text, name


def test_metrics_explains_every_column_of_the_episodes() -> None:
    text = (ROOT / "docs" / "metrics.md").read_text(encoding="utf-8")
    part = text.split("## episodes.csv")[1].split("\n## ")[0]
    assert [name for name in COLUMNS if f"`{name}`" not in part] == []


def test_the_tables_of_keys_are_those_of_the_dataclasses() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "configuration.py"))
    page = (ROOT / "docs" / "configuration.md").read_text(encoding="utf-8")
    assert script["filled"](page) == page, "run python docs/configuration.py"
    for group, choices in re.findall(r"^## (\w+): (.*)$", page, re.MULTILINE):
        there = {file.stem for file in (ROOT / "conf" / group).glob("*.yaml") if not file.stem.startswith("_")}
        assert set(re.findall(r"`([^`]+)`", choices)) == there, f"the choices in the heading of {group}"


def test_every_link_leads_to_a_file_and_a_heading() -> None:
    for page in PAGES:
        for target, heading in re.findall(r"\]\(([^)#]*)(?:#([^)]*))?\)", page.read_text(encoding="utf-8")):
            if target.startswith("http"):
                continue
            file = page.parent / target if target else page
            assert file.exists(), f"{page.name}: {target}"
            assert not heading or heading in headings(file), f"{page.name}: {target}#{heading}"


def headings(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    lines = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", line.lower()).replace(" ", "-") for line in lines}
