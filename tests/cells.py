"""The paper's cell, as a value and as the section of a config.yaml."""

from __future__ import annotations

from hrl_comfort.composition.compose import compose_environment
from hrl_comfort.config.overrides import config_dir

PAPER = compose_environment("train").cell
SECTION = "cell:\n" + "".join(
    f"  {line}\n" for line in (config_dir() / "cell" / "paper.yaml").read_text(encoding="utf-8").splitlines()
)
