"""Any override or configuration file gives a one-line error or finite numbers."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hrl_comfort import humans
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import TrainConfig
from hrl_comfort.config import comfort as allowed
from hrl_comfort.config.overrides import ROOTS, groups, override
from hrl_comfort.files.run_config import environment, is_same, load_config, save_config
from hrl_comfort.sim.engine import Engine
from hrl_comfort.tasks import SUBTASKS
from tests.generating import CHANGES, FOREIGN, ODD, changed, inputs, numbers, tried

SCALARS = st.one_of(
    st.sampled_from(ODD),
    st.integers().map(str),
    st.floats().map(str),
    st.text(max_size=12).map(lambda text: override("", text)[1:]),
    st.text(max_size=12),
)
VALUES = st.one_of(
    SCALARS,
    st.recursive(
        SCALARS,
        lambda inner: st.one_of(
            st.lists(inner, max_size=7).map(lambda each: f"[{','.join(each)}]"),
            st.dictionaries(st.sampled_from("abc"), inner, max_size=2).map(
                lambda each: "{" + ",".join(f"{key}:{value}" for key, value in each.items()) + "}"
            ),
        ),
        max_leaves=8,
    ),
    st.integers(1, 2000).map(lambda depth: "[" * depth + "]" * depth),
)


def keys(kind: Any, before: str = "") -> Iterator[str]:
    """Yield every key of a configuration class, its sections too."""
    for name, hint in get_type_hints(kind).items():
        yield before + name
        if dataclasses.is_dataclass(hint):
            yield from keys(hint, f"{before}{name}.")


def lines(root: str) -> st.SearchStrategy[str]:
    """Return overrides of `root`, valid and invalid."""
    known = st.sampled_from(sorted({*keys(ROOTS[root]), *groups(root), "policies.pick", "hydra.run.dir"}))
    key = st.one_of(known, known, known, known.map(lambda key: f"{key}.a"), st.text(max_size=8))
    choices = st.sampled_from([f"{group}={name}" for group, names in groups(root).items() for name in names])
    prefix = st.sampled_from(["", "", "", "", "+", "++", "~"])
    said = st.builds(lambda before, key, value: f"{before}{key}={value}", prefix, key, VALUES)
    return st.one_of(said, said, said, choices) if groups(root) else said


COMMANDS = st.sampled_from(sorted(ROOTS)).flatmap(
    lambda root: st.tuples(st.just(root), st.lists(lines(root), min_size=1, max_size=3))
)


@inputs(0.15)
@given(command=COMMANDS)
def test_no_override_crashes_and_what_is_accepted_is_finite_and_loads_back(
    command: tuple[str, list[str]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    root, overrides = command
    config = tried(lambda: compose(root, overrides))
    if config is not None:
        assert all(map(math.isfinite, numbers(dataclasses.asdict(config))))
        file = tmp_path_factory.getbasetemp() / "written.yaml"
        save_config(config, file)
        loaded = load_config(file)
        assert is_same(loaded, config)
        assert getattr(loaded, "output", str(file.parent)) == str(file.parent)  # `results` has none


WORLD = ("robot", "cell", "human", "comfort", "task", "reward")
PLAIN = [str(n) for n in (0, 1e-3, 0.01, 0.1, 0.5, 0.9, 1, 2, 3, 5, 8, 60, 100, 1000, -1, -0.5, -100)]
WORDS = sorted(
    {*allowed.FORMS, *allowed.THRESHOLDS, *allowed.SPEED_FORMS, *allowed.DISTANCES, *humans.MOTIONS}
    | {
        "none",
        "fixed",
        "random",
        "changing",
        "simulated",
        "frightened",
        "fitted",
        "cartesian",
        "paper",
        "full",
        "partial",
        "points",
    }
    | {"anywhere", "true", "null"}
)
PLACES = [f"[{x},{y}{z}]" for x in (0, 0.3, -2, 1e9) for y in (0.1, -1e300) for z in ("", ",0.2")]
SAID_OF_THE_WORLD = st.tuples(
    st.sampled_from(sorted(key for key in keys(TrainConfig) if key.split(".")[0] in WORLD and "." in key)),
    st.sampled_from([*PLAIN, *PLAIN, *WORDS, *PLACES, "[[0.5,0.5]]", "[[0,0],[1e9,1]]", "[0,90,0,90,0,1e6]"]),
).map("=".join)


@inputs(0.03)
@given(
    task=st.sampled_from(sorted(SUBTASKS)),
    comfort=st.sampled_from(["off", "conditioned", "paper"]),
    said=st.lists(SAID_OF_THE_WORLD, min_size=1, max_size=3),
)
def test_a_world_that_is_accepted_makes_a_finite_step(task: str, comfort: str, said: list[str]) -> None:
    def stepped() -> list[torch.Tensor]:
        config = compose("train", [f"task={task}", f"comfort={comfort}", *said])
        assert isinstance(config, TrainConfig)
        engine = Engine(environment(config), 2, 0)
        engine.reset()
        outcome = engine.step(np.ones((2, 6)))
        return [engine.episodes.subtask.observe(outcome.state), outcome.reward, outcome.reward_terms]

    for tensor in tried(stepped) or []:
        assert tensor.isfinite().all()


def value_changed(text: str, line: int, value: str) -> str:
    """Return the YAML text with another value in a line (index modulo their number)."""
    rows = text.splitlines()
    rows[line % len(rows)] = f"{rows[line % len(rows)].split(':')[0]}: {value}"
    return "\n".join(rows)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Return configurations as runs write them."""
    file, texts = tmp_path_factory.mktemp("written") / "config.yaml", []
    for root in ("train", "train_meta_controller", "evaluate"):
        save_config(compose(root), file)
        texts.append(file.read_text(encoding="utf-8"))
    return texts


@inputs(0.1)
@given(
    which=st.integers(0, 2),
    change=st.one_of(CHANGES, CHANGES, st.sampled_from(FOREIGN), st.tuples(st.integers(0, 400), VALUES)),
)
def test_no_configuration_file_crashes(
    which: int, change: Any, written: list[str], fresh: Callable[[bytes], Path]
) -> None:
    text = written[which]
    if isinstance(change, bytes):
        content = change
    elif isinstance(change, tuple):
        content = value_changed(text, *change).encode("utf-8", "surrogatepass")
    else:
        content = changed(text.encode(), change)
    file = fresh(content)
    config = tried(lambda: load_config(file))
    assert config is None or all(map(math.isfinite, numbers(dataclasses.asdict(config))))
