"""Shared parts of tests with generated inputs: number of inputs, refusals, odd values and damage.

HRL_COMFORT_INPUTS says how many are generated in all. By default they are few, and the same every time;
where it is set they are drawn anew.
"""

from __future__ import annotations

import dataclasses
import math
import os
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import numpy as np
import torch
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import FAR_AWAY_M, ConfigError, TrainConfig
from hrl_comfort.config.checks import MAX_LINE
from hrl_comfort.tasks import State

T = TypeVar("T")
FEW = 400
INPUTS = int(os.environ.get("HRL_COMFORT_INPUTS", FEW))
RAN: Counter[str] = Counter()


def inputs(share: float) -> settings:
    """Return settings of a property that gets `share` of all inputs."""
    return settings(
        max_examples=max(1, math.ceil(share * INPUTS)),
        derandomize="HRL_COMFORT_INPUTS" not in os.environ,
        deadline=None,
        database=None,
        phases=[Phase.generate],  # shrinking takes minutes
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )


def tried(call: Callable[[], T]) -> T | None:
    """Return the result of `call`, or None if it raises a one-line ConfigError; other errors propagate."""
    RAN["generated"] += 1
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return call()
    except ConfigError as error:
        line = str(error)
        assert line.strip() and len(line.splitlines()) == 1, f"not one line: {line!r}"
        assert line.isprintable() and len(line) <= MAX_LINE + 3, f"nobody can read {line[:200]!r}"
        RAN["refused"] += 1
        return None


def numbers(tree: Any) -> Iterator[float]:
    """Yield every number of nested dicts and lists."""
    if isinstance(tree, (dict, list, tuple)):
        for value in tree.values() if isinstance(tree, dict) else tree:
            yield from numbers(value)
    elif isinstance(tree, (int, float)):
        yield float(tree)


ODD = [
    "nan", "inf", "-inf", "1e999", "-1", "0", "1", "2147483648", str(2**63), "9" * 400, "9" * 4900, "1e-320",
    "-0.0", "1_0", "0x1f", "null", "~", "true", "''", "' '", "ü", "???", "'???'", "${nowhere}", "${",
    "${task.name}", "${task}", "${output}", "${now:%Y}", "${evaluation_folder:a}", "${oc.env:NOWHERE}",
    "}", "[", "[[]]", "a" * 5000, "'a\nb'", "'\x00'", "'\ud800'", "/", "..", "expert", "{}", "[]", "[1,2]",
    "{a:1}", "a=b", "1,2", "range(1,3)", "choice(1,2)", "glob(*)", "sort(1,2)", "int(a)", "float(nan)",
    "extend_list(1)", "*a",
]  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Change:
    """A replacement of some bytes at a relative place (0 to 1) of a file."""

    place: float
    removed: int
    put: bytes

    def made(self, content: bytes) -> bytes:
        at = int(self.place * len(content))
        return content[:at] + self.put + content[at + self.removed :]


CHANGES = st.lists(
    st.builds(
        Change,
        st.floats(0, 1, exclude_max=True),
        st.one_of(st.integers(0, 4), st.just(10**9)),
        st.one_of(st.binary(max_size=3), st.sampled_from([odd.encode("utf-8", "replace") for odd in ODD])),
    ),
    min_size=1,
    max_size=4,
)
FOREIGN = [
    b"", b"\x00", b"\xff\xfe", b"- 1", b"a: b", b"{}", b"a: [", b"? ", b"&a [*a]", b"%YAML 9",
    b"\xef\xbb\xbf",
]  # fmt: skip


def changed(content: bytes, changes: list[Change]) -> bytes:
    for change in changes:
        content = change.made(content)
    return content


TRAINED = compose("train", ["comfort=conditioned"])
assert isinstance(TRAINED, TrainConfig)
COMFORT = TRAINED.comfort
SIZES = {
    "joint_pos": (6,), "joint_vel": (6,), "joint_target": (6,), "joint_home": (6,), "points": (2, 3),
    "humans_pos": (1, 2), "humans_seen": (1, 2), "humans_vel": (1, 2), "humans_yaw": (1,), "grasp_tolerance": (),
    "humans_stood": (1,), "humans_side": (1,),
    "place_tolerance": (), "home_tolerance": (), "share": (), "share_sum": (), "protective_stops": (),
    "human_beyond_bound": (), "arm_distance": (), "home_distance": (),
    "level": (), "objects": (1, 3), "layout": (3, 7), "tops": (3, 6),
    "kind_places": (2, 3), "arm_body": (4, 7), "hand_body": (2, 7), "humans_body": (5, 7), "humans_body_vel": (5, 6),
}  # fmt: skip
"""Shape of a row of fields of `State`; the others are points."""
FLAGS = ("braking", "touching", "contact", "unsafe_contact", "table_collision", "self_collision")
ROWS = 4


def random_state(rng: np.random.Generator, exponents: tuple[int, int]) -> State:
    """Return a state of random finite numbers with these exponents of ten, some of them zero or equal."""

    def numbers_of(size: tuple[int, ...]) -> torch.Tensor:
        scale = 10.0 ** rng.uniform(*sorted(exponents), (ROWS, *size))
        kept = rng.random((ROWS, *size)) > 0.2
        return torch.from_numpy(rng.choice([-1.0, 1.0], (ROWS, *size)) * scale * kept)

    whole: dict[str, torch.Tensor] = {
        "kinds": torch.from_numpy(rng.integers(2, size=(ROWS, 1))),
        "placed": torch.from_numpy(rng.random((ROWS, 1)) < 0.5),
        "target": torch.zeros(ROWS, dtype=torch.int64),
        "stage": torch.from_numpy(rng.integers(4, size=ROWS)),
        "steps": torch.from_numpy(rng.integers(10**6, size=ROWS)),
        "key": torch.from_numpy(rng.integers(2**63, size=ROWS)),
        "level": torch.from_numpy(rng.integers(1, COMFORT.levels + 1, size=ROWS).astype(np.float64)),
        "humans_shown": torch.from_numpy(rng.random((ROWS, 1)) < 0.5),
        **{name: torch.from_numpy(rng.random(ROWS) < 0.5) for name in FLAGS},
    }
    names = [field.name for field in dataclasses.fields(State) if field.name != "object_slots"]
    state = State(**{name: whole.get(name, numbers_of(SIZES.get(name, (3,)))) for name in names})
    if rng.random() < 0.3:
        away = torch.tensor([[FAR_AWAY_M, 0.0]], dtype=torch.float64).expand(ROWS, 1, 2)
        return state.with_(humans_pos=away, humans_seen=away, arm_distance=torch.full((ROWS,), math.nan))
    return state.with_(humans_pos=state.tcp_pos[:, None, :2].clone()) if rng.random() < 0.3 else state
