"""Build the site: `python docs/site/build.py`, which `make docs` runs. It opens from disk: build/docs/site/index.html.

The pages are README.md, docs/*.md, CONTRIBUTING.md, CHANGELOG.md and the examples, an API reference from the
docstrings, and the page of `hrl-comfort studio export=`, which plays committed policies. Needs the extra `docs`, and
`make page` for the last of these.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
BUILD = ROOT / "build" / "docs"
PAGES, SITE = BUILD / "pages", BUILD / "site"
SHIM = "https://unpkg.com/iframe-worker/shim"
"""Files that the theme loads from the network; the site has them beside its pages."""
PLAYED = ["policy=runs/reference/comfort_shift/levels0", "human=mixture"]
"""Overrides of the studio for the page that plays."""
NAMES = {
    ROOT / "README.md": "index.md",
    ROOT / "CONTRIBUTING.md": "contributing.md",
    ROOT / "CHANGELOG.md": "changelog.md",
    ROOT / "examples": "examples.md",
}
"""Pages that do not come from docs/."""
NAV = {
    "Guide": "tasks humans comfort hierarchy safety studio results",
    "How to": "commands examples environments bring_your_own sweeps randomise robot export",
    "Reference": "configuration metrics",
    "Project": "design decisions contributing changelog",
}
"""Pages by section, in order; one that is not there is left out."""
API = (
    "agents", "analysis", "comfort", "deploy", "envs", "evaluation", "hierarchy", "humans", "policies", "safety",
    "scene", "sim", "tasks", "training",
)  # fmt: skip
"""Folders of the package in the API reference."""
LINK = re.compile(r"(\]\()(?!https?:|#|mailto:)([^)#\s]+)")


def stage() -> None:
    """Write every page to PAGES: those of the repository with their links, and those that only the site has."""
    shutil.rmtree(BUILD, ignore_errors=True)
    shutil.copytree(ROOT / "docs", PAGES, ignore=shutil.ignore_patterns("site", "*.py", "*.sh"))
    shutil.copy(HERE / "extra.css", PAGES)
    for source, name in NAMES.items():
        (PAGES / name).write_text(source.read_text("utf-8") if source.is_file() else scripts(source), encoding="utf-8")
    for page in sorted(PAGES.rglob("*.md")):
        folder = ROOT if page.name in NAMES.values() else ROOT / "docs" / page.parent.relative_to(PAGES)
        text = LINK.sub(lambda link, at=page, of=folder: link[1] + moved(link[2], at, of), page.read_text("utf-8"))
        page.write_text(text, encoding="utf-8")
    modules = api()
    play()
    nav = [entry("Home", "index.md"), entry("Play", "play.md")]
    for section, names in NAV.items():
        there = [name for name in names.split() if (PAGES / f"{name}.md").exists()]
        nav.append(f'{{"{section}" = [{", ".join(entry(title(name), f"{name}.md") for name in there)}]}}')
    nav.append(f'{{"API" = [{", ".join(entry(name, f"api/{name}.md") for name in modules)}]}}')
    settings = (HERE / "zensical.toml").read_text(encoding="utf-8")
    text = settings.replace("[project]\n", f"[project]\nnav = [{', '.join(nav)}]\n", 1)
    (BUILD / "zensical.toml").write_text(text, encoding="utf-8")


def moved(target: str, page: Path, folder: Path) -> str:
    """Return a link's target for the site; files that are no pages of it are copied to `files/`."""
    file = (folder / target).resolve()
    if file in NAMES:
        place = PAGES / NAMES[file]
    elif file.is_relative_to(ROOT / "docs") and (PAGES / file.relative_to(ROOT / "docs")).exists():
        place = PAGES / file.relative_to(ROOT / "docs")
    elif file.is_file():
        place = PAGES / "files" / file.relative_to(ROOT)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(file, place)
    else:
        raise FileNotFoundError(f"{page.name} links to {target}, which is no file")
    return Path("../" * len(page.parent.relative_to(PAGES).parts), place.relative_to(PAGES)).as_posix()


def scripts(folder: Path) -> str:
    """Return the page of the examples."""
    texts = ((file.name, file.read_text(encoding="utf-8")) for file in sorted(folder.glob("*.py")))
    return "# Examples\n\n" + "\n\n".join(f"## {name}\n\n```python\n{text}```" for name, text in texts) + "\n"


def title(name: str) -> str:
    """Return the heading of a page."""
    found = re.search(r"^# (.*)$", (PAGES / f"{name}.md").read_text(encoding="utf-8"), re.MULTILINE)
    return found[1] if found else name


def entry(name: str, page: str) -> str:
    """Return an entry of the list of pages, in TOML."""
    return f'{{"{name}" = "{page}"}}'


def api() -> list[str]:
    """Write a page of the API reference for each part of the package; return their names."""
    (PAGES / "api").mkdir()
    parts = {"hrl_comfort": ["hrl_comfort", "hrl_comfort.gym", "hrl_comfort.sb3"]}
    for part in API:
        files = sorted(file for file in (ROOT / "hrl_comfort" / part).rglob("*.py") if file.name[0] != "_")
        names = [".".join(file.relative_to(ROOT).with_suffix("").parts) for file in files]
        parts[part] = [f"hrl_comfort.{part}", *names]
    for name, modules in parts.items():
        text = "\n\n".join(f"::: {module}" for module in modules)
        (PAGES / "api" / f"{name}.md").write_text(f"# {name}\n\n{text}\n", encoding="utf-8")
    return list(parts)


def play() -> None:
    """Write the page that plays committed policies, with its frame."""
    command = [sys.executable, "-m", "hrl_comfort", "studio", *PLAYED, f"export={PAGES / 'player.html'}"]
    subprocess.run(command, cwd=ROOT, check=True)
    (PAGES / "play.md").write_text(
        "---\nhide: [toc]\n---\n\n# Play\n\n"
        "Three policies, for pick, place and return, trained for ten comfort levels, with the shield between them and "
        "the arm. Drag the person, or move the slider. [Open it alone](player.html).\n\n"
        '<iframe class="player" src="player.html" title="A robot arm works beside a person"></iframe>\n',
        encoding="utf-8",
    )


def build() -> None:
    """Build SITE from PAGES, with nothing that it loads from the network."""
    subprocess.run([sys.executable, "-m", "zensical", "build", "--clean", "--strict"], cwd=BUILD, check=True)
    shutil.copy(HERE / "iframe_worker.js", SITE / "assets")
    for page in SITE.rglob("*.html"):
        depth = "../" * len(page.parent.relative_to(SITE).parts)
        text = page.read_text(encoding="utf-8")
        page.write_text(text.replace(SHIM, f"{depth}assets/iframe_worker.js"), encoding="utf-8")


if __name__ == "__main__":
    stage()
    build()
    print(SITE / "index.html")
