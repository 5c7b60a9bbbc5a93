"""Configuration of the benchmark: the keys of an evaluation, and the tasks of its suite."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BeforeValidator

from hrl_comfort.config.checks import ConfigError
from hrl_comfort.config.commands import EvaluateConfig

SUITE = {"kitting": "fetcher", "shift": "mixture"}
"""Tasks of the benchmark, and the people (`human=`) beside whom each is done."""


def _of_suite(given: Any) -> Any:
    """Return the tasks of `suite`, or what was composed of them; raise ConfigError for others."""
    if not isinstance(given, dict):
        named = [each for each in SUITE if isinstance(given, list) and given.count(each) == 1]
        if not named or len(named) != len(given):
            raise ConfigError(f"={given!r} must name one or several of {', '.join(SUITE)}: suite=[{','.join(SUITE)}]")
    return given


@dataclass(frozen=True)
class BenchmarkConfig(EvaluateConfig):
    """`hrl-comfort benchmark`: the keys of every part, and the parts."""

    suite: Annotated[list[str] | dict[str, EvaluateConfig], BeforeValidator(_of_suite)]
    """Tasks that are run: `kitting` beside `human=fetcher`, `shift` beside `human=mixture`. Other keys hold for all."""

    @property
    def parts(self) -> dict[str, EvaluateConfig]:
        """The configuration of each task."""
        assert isinstance(self.suite, dict), "composed"
        return self.suite
