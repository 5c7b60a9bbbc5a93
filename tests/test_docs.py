"""The docs hold: generated pages are the code's, commands name what exists, links hold, and pages stay short."""

from __future__ import annotations

import re
import runpy
import shlex
from collections.abc import Sequence
from pathlib import Path

import pytest

from hrl_comfort.agents.baselines.option_critic import OptionCritic
from hrl_comfort.comfort import sources, terms
from hrl_comfort.config.overrides import check_overrides
from hrl_comfort.evaluation import handover
from hrl_comfort.evaluation.episode import COLUMNS as EPISODES
from hrl_comfort.files.documents import read_yaml
from hrl_comfort.training.logger import TIMING, MetricsLog, OptionsLog

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
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


def test_generated_pages_are_those_of_the_code() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "site" / "reference.py"))
    for name, page in script["PAGES"].items():
        assert (ROOT / "docs" / name).read_text(encoding="utf-8") == page(), "run python docs/site/reference.py"


@pytest.mark.parametrize(
    ("file", "header"),
    [
        ("eval/episodes.csv", EPISODES),
        ("metrics.csv", MetricsLog(Path(), ("NAME",), (*OptionCritic.terms, "upper_NAME"), config=None).columns),
        ("timing.csv", TIMING),
        ("meta_controller_metrics.csv", OptionsLog(Path(), ["NAME"]).columns),
        ("handover.csv", handover.HANDOVER),
        ("handover_episodes.csv", handover.SINGLE),
        ("seams.csv", handover.FAR_OBSERVATIONS),
        ("chain.csv", handover.CHAIN),
    ],
)
def test_every_column_of_a_table_has_a_meaning(file: str, header: Sequence[str]) -> None:
    told = read_yaml(ROOT / "docs" / "site" / "columns.yaml")[1]["tables"][file]["columns"]
    assert sorted(", ".join(told).split(", ")) == sorted(header)


def test_readme_pages_changelog_and_examples_are_short() -> None:
    pages = [page for page in PAGES if page.name not in ("configuration.md", "metrics.md")]
    assert words(ROOT / "README.md", tables=True) <= 900
    assert sum(words(page) for page in pages) <= 15_000
    assert words(ROOT / "CHANGELOG.md", tables=True) <= 800
    assert [file.name for file in EXAMPLES if len(file.read_text(encoding="utf-8").splitlines()) > 40] == []


def words(page: Path, tables: bool = False) -> int:
    """Return the number of words of a page, by default without its tables."""
    lines = page.read_text(encoding="utf-8").splitlines()
    return sum(len(line.split()) for line in lines if tables or not line.startswith("|"))


def test_every_link_leads_to_a_file_and_a_heading() -> None:
    for page in [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]:
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
