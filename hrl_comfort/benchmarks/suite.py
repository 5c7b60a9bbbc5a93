"""`hrl-comfort benchmark`: the suite of conf/benchmark.yaml for one policy, beside the entries of others."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from pandas import json_normalize

from hrl_comfort.analysis.summary import summarise
from hrl_comfort.benchmarks.entries import ENTRIES, FILE, QUANTITIES, Entry, committed, table
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig
from hrl_comfort.evaluation.evaluate import evaluate
from hrl_comfort.evaluation.ledger import hash_of
from hrl_comfort.files.atomic import write_json, write_text
from hrl_comfort.files.provenance import commit
from hrl_comfort.files.run_config import trained_environment
from hrl_comfort.files.tables import read_table
from hrl_comfort.plots.benchmark import front
from hrl_comfort.plots.style import save_png

OWN = ("policy", "policies", "output", "engine.threads", "engine.processes", "record", "realtime", "task.observation")
"""Keys that a policy may set without leaving the suite; the last two say what an outside policy observes."""


def benchmark(config: EvaluateConfig) -> Path:
    """Run the suite; write benchmark.json, the entry, and benchmark.md and .png, which have those of ENTRIES too.

    Return the entry's file.

    Raises:
      ConfigError: the task is another than the suite's, there is no level, a policy was trained with other steps, or a
        committed entry is damaged.
    """
    if config.task.name != "shift":
        raise ConfigError(f"task={config.task.name}: the benchmark's figures are of task=shift alone")
    for name, source in config.policies.items():
        check_steps(config, name, source)
    if config.comfort.source == "none":
        raise ConfigError("comfort.source=none: the benchmark's discomfort is that of a level")
    mine = Path(config.output).resolve()
    others = [entry for name, entry in committed(ENTRIES).items() if not mine.is_relative_to(ENTRIES / name)]
    output = evaluate(config)
    entry = entry_of(config, output)
    every = [*others, entry]
    write_json(output / FILE, entry)
    write_text(output / "benchmark.md", table(every))
    save_png(front(every), output / "benchmark.png")
    print(table([entry]), end="")
    return output / FILE


def check_steps(config: EvaluateConfig, name: str, source: str) -> None:
    """Raise ConfigError if the policy `source` is of a run whose actions are in units of another step."""
    here = config.task.max_step_deg
    trained = trained_environment(source)
    if trained is not None and (there := trained.task.max_step_deg) != here:
        raise ConfigError(
            f"task.max_step_deg={here:g}, but policies.{name}={source!r} was trained with {there:g}, the unit of its "
            f"actions; give task.max_step_deg={there:g}, which is outside the suite"
        )


def entry_of(config: EvaluateConfig, folder: Path) -> Entry:
    """Return the entry of the evaluation in `folder`: policy, what differs from the suite, means by level."""
    episodes = read_table(folder / "episodes.csv")
    assert episodes is not None, "an evaluation has episodes"
    groups = summarise(episodes, [], config.task.max_episode_steps)["groups"]
    levels: list[Any] = [
        {
            "level": group["comfort_level"],
            "shifts": group["episodes"],
            **{name: group["metrics"][name] for name in QUANTITIES if name in group["metrics"]},
        }
        for group in groups
    ]
    return {
        "policy": name_of(config),
        "policies": {name: hash_of(source) for name, source in config.policies.items()},
        "commit": commit(),
        "observation": {"task.observation": config.task.observation},
        "changed": changed(config),
        "levels": levels,
    }


def name_of(config: EvaluateConfig) -> str:
    """Return the name of an entry: its one policy, or the folder of its policies."""
    sources = set(config.policies.values())
    parents = {str(Path(source).parent) for source in sources}
    return " ".join(sorted(sources if len(sources) == 1 or len(parents) > 1 else parents))


def changed(config: EvaluateConfig) -> dict[str, Any]:
    """Return the keys of a configuration that are not as in the suite, with their values."""
    suite, asked = (json_normalize(asdict(each)).iloc[0].to_dict() for each in (compose("benchmark"), config))
    return {
        key: value
        for key, value in asked.items()
        if key not in OWN and not key.startswith("policies.") and (key not in suite or str(suite[key]) != str(value))
    }
