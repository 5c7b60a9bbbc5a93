"""The docs hold: tables come from the committed results, commands name what exists."""

from __future__ import annotations

import re
import runpy
import shlex
from pathlib import Path

import pytest

from hrl_comfort.compose import check_overrides, load_config
from hrl_comfort.experiments.training_log import read_provenance

ROOT = Path(__file__).resolve().parent.parent
REFERENCE = ROOT / "runs" / "reference"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
IMAGINED = "hover"
"""The task that docs/add_a_task.md adds."""
EXPERIMENTS = sorted((ROOT / "conf" / "experiment").glob("*.yaml"))


def commands() -> list[tuple[str, str]]:
    found = []
    for page in [*PAGES, *EXPERIMENTS]:
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        lines = re.findall(r"^(?:#\s+)?hrl-comfort (?:train|evaluate) .*$", text, re.MULTILINE)
        found += [(page.name, line.removeprefix("#").strip()) for line in lines if IMAGINED not in line]
    return found


@pytest.mark.parametrize(("page", "line"), commands())
def test_every_command_in_the_docs_is_accepted(page: str, line: str) -> None:
    _, verb, *words = shlex.split(line, comments=True)
    overrides = [word for word in words if word != "-m"]
    assert check_overrides(verb, overrides, sweep="-m" in words), page


def test_tables_are_those_of_the_committed_evaluations() -> None:
    tables = runpy.run_path(str(ROOT / "docs" / "tables.py"))
    page = tables["PAGE"].read_text(encoding="utf-8")
    assert tables["filled"](page) == page, "run python docs/tables.py"


@pytest.mark.parametrize(
    "folder", sorted(path.parent for path in REFERENCE.rglob("policy.pt")), ids=lambda path: path.name
)
def test_a_reference_policy_is_finished_and_its_configuration_loads(folder: Path) -> None:
    assert read_provenance(folder)["finished"]
    assert load_config(folder).output == str(folder.relative_to(ROOT))


def test_every_link_between_pages_leads_somewhere() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            if not target.startswith("http"):
                assert (page.parent / target).exists(), f"{page.name}: {target}"
