"""`hrl-comfort benchmark`: the suite of conf/benchmark.yaml for one policy and top, beside the entries of others."""

from __future__ import annotations

from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from pandas import json_normalize

from hrl_comfort.analysis.summary import summarise
from hrl_comfort.benchmarks.entries import ENTRIES, FILE, QUANTITIES, Entry, Level, committed, tables
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import BenchmarkConfig, ConfigError, EvaluateConfig
from hrl_comfort.config.hierarchy import OPTION_KEYS
from hrl_comfort.config.overrides import override
from hrl_comfort.config.suite import SUITE
from hrl_comfort.evaluation.evaluate import evaluate
from hrl_comfort.evaluation.ledger import hash_of
from hrl_comfort.files.atomic import write_json, write_text
from hrl_comfort.files.output import output_folder
from hrl_comfort.files.provenance import commit
from hrl_comfort.files.run_config import environment, trained_environment
from hrl_comfort.files.tables import read_table
from hrl_comfort.hierarchy.controllers import make_executor
from hrl_comfort.plots.benchmark import front
from hrl_comfort.plots.style import save_png
from hrl_comfort.sim.engine import Engine

TOP = tuple(f"meta_controller.{name}" for name in ("name", *OPTION_KEYS, "order"))
"""Keys of the top, which belong to an entry as its policies do."""
OWN = (
    "policy", "policies", "output", "engine.threads", "engine.processes", "record", "realtime", "task.observation",
    *TOP,
)  # fmt: skip
"""Keys that an entry may set without leaving the suite; `task.observation` says what an outside policy observes."""


def benchmark(config: BenchmarkConfig) -> Path:
    """Run the suite; write benchmark.json, the entry, and benchmark.md and .png, which have those of ENTRIES too.

    The evaluation of each task is in a folder of its name. Return the entry's file.

    Raises:
      ConfigError: there is no level, a policy or top does not fit or was trained with other steps, or a committed entry
        is damaged.
    """
    output = Path(config.output)
    parts = {name: replace(part, output=str(output / name)) for name, part in config.parts.items()}
    for part in parts.values():
        check(part)
    mine = output.resolve()
    others = [entry for name, entry in committed(ENTRIES).items() if not mine.is_relative_to(ENTRIES / name)]
    with output_folder(output, EvaluateConfig, *(f"{name}/config.yaml" for name in SUITE)):
        for part in parts.values():
            evaluate(part)
        entry = entry_of(parts)
        every = [*others, entry]
        write_json(output / FILE, entry)
        write_text(output / "benchmark.md", tables(every))
        save_png(front(every), output / "benchmark.png")
    print(tables([entry]), end="")
    return output / FILE


def check(part: EvaluateConfig) -> None:
    """Raise ConfigError if a part of the suite cannot be run, before any of it is."""
    if part.comfort.source == "none":
        raise ConfigError("comfort.source=none: the benchmark's discomfort is that of a level")
    for name, source in part.policies.items():
        if name != "meta_controller":
            check_steps(part, f"policies.{name}", source)
    with closing(Engine(environment(part), 1, 0)) as engine:
        make_executor(part, None, engine, part.first_seed)


def check_steps(config: EvaluateConfig, key: str, source: str) -> None:
    """Raise ConfigError if the policy `source`, the value of `key`, acts in units of another step than `config` has."""
    here = config.task.max_step_deg
    trained = trained_environment(source)
    if trained is not None and (there := trained.task.max_step_deg) != here:
        raise ConfigError(
            f"task.max_step_deg={here:g}, but {key}={source!r} was trained with {there:g}, the unit of its "
            f"actions; give task.max_step_deg={there:g}, which is outside the suite"
        )


def entry_of(parts: dict[str, EvaluateConfig]) -> Entry:
    """Return the entry of the evaluations of `parts`: policies, top, what differs from the suite, means by level."""
    first = next(iter(parts.values()))
    return {
        "policy": name_of(first),
        "policies": {name: hash_of(source) for name, source in first.policies.items()},
        "top": top_of(first),
        "commit": commit(),
        "observation": {"task.observation": first.task.observation},
        "changed": {key: value for part in parts.values() for key, value in changed(part).items()},
        "parts": {name: levels_of(part) for name, part in parts.items()},
    }


def levels_of(part: EvaluateConfig) -> list[Level]:
    """Return the means at each level of the evaluation of a part."""
    episodes = read_table(Path(part.output) / "episodes.csv")
    assert episodes is not None, "an evaluation has episodes"
    levels: list[Any] = [
        {
            "level": group["comfort_level"],
            "shifts": group["episodes"],
            **{name: group["metrics"][name] for name in QUANTITIES if name in group["metrics"]},
        }
        for group in summarise(episodes, [], part.task.max_episode_steps)["groups"]
    ]
    return levels


def name_of(config: EvaluateConfig) -> str:
    """Return the name of an entry: its one policy, or the folder of its policies, and the keys of its top."""
    sources = {source for name, source in config.policies.items() if name != "meta_controller"}
    parents = {str(Path(source).parent) for source in sources}
    skills = sorted(sources if len(sources) == 1 or len(parents) > 1 else parents)
    usual, learned = top_of(suite(config.task.name)), config.policies.get("meta_controller")
    top = [override(key, value) for key, value in top_of(config).items() if value != usual[key]]
    return " ".join([*skills, *top, *([] if learned is None else [learned])])


def top_of(config: EvaluateConfig) -> dict[str, Any]:
    """Return the values of TOP."""
    return {key: getattr(config.meta_controller, key.partition(".")[2]) for key in TOP}


def suite(task: str) -> EvaluateConfig:
    """Return the part `task` of the suite as it stands in conf/."""
    whole = compose("benchmark", [f"suite=[{task}]"])
    assert isinstance(whole, BenchmarkConfig)
    return whole.parts[task]


def changed(config: EvaluateConfig) -> dict[str, Any]:
    """Return the keys of a part that are not as in the suite, with their values."""
    usual, asked = (json_normalize(asdict(each)).iloc[0].to_dict() for each in (suite(config.task.name), config))
    return {
        key: value
        for key, value in asked.items()
        if key not in OWN and not key.startswith("policies.") and (key not in usual or str(usual[key]) != str(value))
    }
