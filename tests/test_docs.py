"""The docs hold: tables come from the committed results, commands name what exists."""

from __future__ import annotations

import re
import runpy
import shlex
from dataclasses import asdict
from pathlib import Path

import pytest

from hrl_comfort.comfort import sources, terms
from hrl_comfort.config.compose import compose
from hrl_comfort.config.overrides import check_overrides
from hrl_comfort.evaluation.rollout import COLUMNS

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
IMAGINED = "hover"
"""The task that docs/add_a_task.md adds."""
EXPERIMENTS = sorted((ROOT / "conf" / "experiment").glob("*.yaml"))


def commands() -> list[tuple[str, str]]:
    found = []
    for page in [*PAGES, *EXPERIMENTS]:
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        lines = re.findall(r"^(?:#\s+)?hrl-comfort (?:train|evaluate|report|figure) .*$", text, re.MULTILINE)
        found += [(page.name, line.removeprefix("#").strip()) for line in lines if IMAGINED not in line]
    return found


@pytest.mark.parametrize(("page", "line"), commands())
def test_every_command_in_the_docs_is_accepted(page: str, line: str) -> None:
    _, verb, *words = shlex.split(line, comments=True)
    if words[0] in ("meta_controller", "handover"):
        verb, words = (
            {"meta_controller": "train_meta_controller", "handover": "evaluate"}[words[0]],
            words[1:],
        )
    overrides = [word for word in words if word not in ("-m", "--together")]
    assert check_overrides(verb, overrides, sweep="-m" in words), page


COMFORT = [line for page, line in commands() if page == "comfort.md" and " -m " not in line]


@pytest.mark.parametrize("line", COMFORT)
def test_every_command_about_comfort_is_a_whole_configuration(line: str) -> None:
    _, verb, *overrides = shlex.split(line, comments=True)
    compose(verb, overrides)


def test_comfort_has_a_command_for_every_source_and_a_word_on_every_form() -> None:
    text = (ROOT / "docs" / "comfort.md").read_text(encoding="utf-8")
    for name in sources.SOURCES:
        assert f"comfort.source={name}" in " ".join(COMFORT) or name == "none", name
    for name in (*sources.SOURCES, *terms.FORMS, *terms.THRESHOLDS, *terms.SPEED_FORMS):
        assert f"`{name}`" in text, name


def test_metrics_explains_every_column_of_the_episodes() -> None:
    text = (ROOT / "docs" / "metrics.md").read_text(encoding="utf-8")
    part = text.split("## episodes.csv")[1].split("\n## ")[0]
    assert [name for name in COLUMNS if f"`{name}`" not in part] == []


def test_configuration_explains_every_key_of_comfort() -> None:
    text = (ROOT / "docs" / "configuration.md").read_text(encoding="utf-8")
    part = text.split("\n## comfort")[1].split("\n## ")[0]
    config = asdict(compose("train").comfort)
    keys = [key for key in config if key not in ("stream", "person")]
    keys += [f"{section}.{key}" for section in ("stream", "person") for key in config[section]]
    assert [key for key in keys if f"`{key}`" not in part] == []


def test_tables_are_those_of_the_committed_evaluations() -> None:
    tables = runpy.run_path(str(ROOT / "docs" / "tables.py"))
    for each in tables["PAGES"]:
        page = each.read_text(encoding="utf-8")
        assert tables["filled"](page) == page, "run python docs/tables.py"


def test_every_link_between_pages_leads_somewhere() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            if not target.startswith("http"):
                assert (page.parent / target).exists(), f"{page.name}: {target}"
