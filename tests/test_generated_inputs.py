"""Whatever is said or read is refused in one line or gives finite numbers; `make fuzz` runs 10,000 inputs.

HRL_COMFORT_INPUTS says how many are generated in all. By default they are few, and the same every time;
where it is set they are drawn anew.
"""

from __future__ import annotations

import copy
import dataclasses
import io
import math
import os
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from hrl_comfort import people
from hrl_comfort.agents import checkpoint
from hrl_comfort.agents.policy import load_policy
from hrl_comfort.comfort import terms
from hrl_comfort.comfort.adapt import with_comfort
from hrl_comfort.comfort.sources import make_source
from hrl_comfort.comfort.streams import Signal
from hrl_comfort.compose import ROOTS, compose, environment, groups, load_config, override, save_config
from hrl_comfort.config import FAR_AWAY_M, ComfortConfig, ConfigError, TrainConfig
from hrl_comfort.config import comfort as allowed
from hrl_comfort.config.checks import LONGEST_LINE
from hrl_comfort.meta.choices import WAIT, Decision
from hrl_comfort.meta.observation import BALL, OTHERS
from hrl_comfort.meta.q_learning import QLearner, load_choice
from hrl_comfort.sim.engine import Engine
from hrl_comfort.tasks import SUBTASKS, State, subtask
from hrl_comfort.tasks.observations import LAYOUTS
from tests.test_checkpoint import write_policy

T = TypeVar("T")
FEW = 400
INPUTS = int(os.environ.get("HRL_COMFORT_INPUTS", FEW))
RAN: Counter[str] = Counter()


@pytest.fixture(scope="module", autouse=True)
def told() -> Iterator[None]:
    """Say how many inputs ran, for whoever looks (pytest -s)."""
    yield
    print(f"\n{RAN['generated']} generated inputs: {RAN['refused']} refused in one line, the others finite")


def inputs(share: float) -> settings:
    """Return settings of a property that gets `share` of all inputs."""
    return settings(
        max_examples=max(1, math.ceil(share * INPUTS)),
        derandomize="HRL_COMFORT_INPUTS" not in os.environ,
        deadline=None,
        database=None,
        phases=[Phase.generate],  # a failure is shown as it came: to make it smaller takes minutes
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )


def tried(call: Callable[[], T]) -> T | None:
    """Return what `call` gives; None where it is refused in one line. Whatever else is raised is a crash."""
    RAN["generated"] += 1
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return call()
    except ConfigError as error:
        line = str(error)
        assert line.strip() and len(line.splitlines()) == 1, f"not one line: {line!r}"
        assert line.isprintable() and len(line) <= LONGEST_LINE + 3, f"nobody can read {line[:200]!r}"
        RAN["refused"] += 1
        return None


def numbers(tree: Any) -> Iterator[float]:
    """Yield every number of nested dicts and lists."""
    if isinstance(tree, (dict, list, tuple)):
        for value in tree.values() if isinstance(tree, dict) else tree:
            yield from numbers(value)
    elif isinstance(tree, (int, float)):
        yield float(tree)


# ---- what is said --------------------------------------------------------------------------------------

ODD = [
    "nan", "inf", "-inf", "1e999", "-1", "0", "1", "2147483648", str(2**63), "9" * 400, "9" * 4900, "1e-320",
    "-0.0", "1_0", "0x1f", "null", "~", "true", "''", "' '", "ü", "???", "'???'", "${nowhere}", "${",
    "${task.name}", "${task}", "${output}", "${now:%Y}", "${evaluation_folder:a}", "${oc.env:NOWHERE}",
    "}", "[", "[[]]", "a" * 5000, "'a\nb'", "'\x00'", "'\ud800'", "/", "..", "expert", "{}", "[]", "[1,2]",
    "{a:1}", "a=b", "1,2", "range(1,3)", "choice(1,2)", "glob(*)", "sort(1,2)", "int(a)", "float(nan)",
    "extend_list(1)", "*a",
]  # fmt: skip
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
    """Return overrides of `root`: of any key, in any form, to anything."""
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
        assert load_config(file) == config


WORLD = ("robot", "cell", "human", "comfort", "task", "reward")
PLAIN = [str(n) for n in (0, 1e-3, 0.01, 0.1, 0.5, 0.9, 1, 2, 3, 5, 8, 60, 100, 1000, -1, -0.5, -100)]
WORDS = sorted(
    {*allowed.FORMS, *allowed.THRESHOLDS, *allowed.SPEED_FORMS, *allowed.DISTANCES, *people.MOTIONS}
    | {"none", "fixed", "random", "changing", "simulated", "cartesian", "paper", "full", "partial", "points"}
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


# ---- what is read --------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Change:
    """A change of some bytes at a place between 0 and 1 of a file."""

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


def value_changed(text: str, line: int, value: str) -> str:
    """Return YAML whose line (modulo their number) has another value."""
    rows = text.splitlines()
    rows[line % len(rows)] = f"{rows[line % len(rows)].split(':')[0]}: {value}"
    return "\n".join(rows)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Configurations as runs keep them."""
    file, texts = tmp_path_factory.mktemp("written") / "config.yaml", []
    for root in ("train", "train_meta", "evaluate"):
        save_config(compose(root), file)
        texts.append(file.read_text(encoding="utf-8"))
    return texts


@pytest.fixture(scope="module")
def fresh(tmp_path_factory: pytest.TempPathFactory) -> Callable[[bytes], Path]:
    """Write bytes to a file that no other example has read."""
    folder, number = tmp_path_factory.mktemp("read"), count()

    def write(content: bytes) -> Path:
        for old in folder.iterdir():
            old.unlink()
        file = folder / f"{next(number)}.file"
        file.write_bytes(content)
        return file

    return write


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


CELLS = st.one_of(
    st.floats().map(str),
    st.floats(-10, 10).map(str),
    st.integers(0, 5).map(str),
    st.sampled_from(
        ["", " ", "nan", "inf", "1e308", "-1e308", "x", "1_0", "٣", '"', "'", "1,5", "\x00", "\ufeff"]
    ),
)


NUMBERS = st.one_of(st.floats(-9, 9), st.floats(-9, 9), st.floats(-9, 9), st.floats()).map(str)


def tables(header: str) -> st.SearchStrategy[bytes]:
    """Return CSV files that should have this header: good and bad headers, cells, separators and ends."""
    width = header.count(",") + 1
    rising = (
        st.integers(1, 6)
        .flatmap(
            lambda rows: st.lists(
                st.lists(NUMBERS, min_size=width - 1, max_size=width - 1),
                min_size=rows,
                max_size=rows,
            )
        )
        .map(lambda rows: [[str(0.5 * k), *row] for k, row in enumerate(rows)])
    )
    any_rows = st.lists(st.lists(CELLS, max_size=width + 1), max_size=5)
    heads = st.sampled_from([*[header] * 12, header.upper(), header[:-2], f"{header},z", "", "0,1"])
    return st.builds(
        lambda start, head, rows, comma, end: (
            start + end.join([head, *(comma.join(row) for row in rows)]).encode("utf-8")
        ),
        st.sampled_from([*[b""] * 6, b"\xef\xbb\xbf", b"\xff", b"\n"]),
        heads,
        st.one_of(rising, any_rows),
        st.sampled_from([*[","] * 12, ";", "\t", ", "]),
        st.sampled_from(["\n", "\n", "\r\n", "\r", "\n\n"]),
    )


def stroll(file: Path) -> list[np.ndarray]:
    """Return where a person of this motion file is, in their first steps."""
    config = replace(HUMAN, motion="playback", file=str(file))
    walk, places = people.begin(config, np.zeros((2, 2))), []
    discs = people.around(np.zeros((1, 2)), 0.1, 2)
    for _ in range(3):
        walk = people.advance(config, walk, np.full((2, people.NOISE), 0.5), np.zeros((2, 2)), discs)
        places += [walk.position, walk.yaw, walk.speed_m_s, walk.walked_m]
    return places


TRAINED = compose("train", ["comfort=conditioned"])
assert isinstance(TRAINED, TrainConfig)
HUMAN, COMFORT = TRAINED.human, TRAINED.comfort


@inputs(0.15)
@given(content=st.one_of(tables("t,x,y,yaw"), tables("t,x,y,yaw"), st.binary(max_size=40)))
def test_no_motion_file_crashes_and_people_are_at_finite_places(
    content: bytes, fresh: Callable[[bytes], Path]
) -> None:
    file = fresh(content)
    for numbers_ in tried(lambda: stroll(file)) or []:
        assert np.isfinite(numbers_).all()


STREAMS = st.builds(
    lambda low, high, tolerance, smoothing_s, stall_s: (
        {"low": low, "high": high, "tolerance": tolerance, "smoothing_s": smoothing_s, "stall_s": stall_s}
    ),
    st.floats(-1e9, 1e9),
    st.floats(-1e9, 1e9),
    st.floats(0, 10),
    st.floats(0, 3600),
    st.floats(0, 3600),
)
TIMES = np.array([0.0, 0.1, 1.0, 1e3, 1e12])


def heard(changes: dict[str, float], **others: Any) -> ComfortConfig:
    return replace(COMFORT, stream=replace(COMFORT.stream, **changes), **others)


def of_range(levels: np.ndarray) -> None:
    assert np.isfinite(levels).all() and (levels >= 1).all() and (levels <= COMFORT.levels).all()


@inputs(0.12)
@given(content=st.one_of(tables("t,value"), tables("t,value"), st.binary(max_size=40)), stream=STREAMS)
def test_no_recording_crashes_and_its_levels_are_of_the_range(
    content: bytes, stream: dict[str, float], fresh: Callable[[bytes], Path]
) -> None:
    file = fresh(content)
    levels = tried(lambda: make_source(heard(stream, source="file", file=str(file)), len(TIMES)).at(TIMES))
    if levels is not None:
        of_range(levels)


ARRIVED = st.lists(
    st.tuples(
        st.one_of(st.floats(0, 5000), st.just(0.0)),
        st.lists(st.one_of(CELLS, st.floats(), st.integers(), st.none()), max_size=3),
    ),
    max_size=8,
)


@inputs(0.1)
@given(arrived=ARRIVED, stream=STREAMS)
def test_no_live_stream_crashes_and_its_levels_are_of_the_range(
    arrived: list[tuple[float, list[Any]]], stream: dict[str, float]
) -> None:
    def levels() -> list[int]:
        now, found = 0.0, []
        signal = Signal(heard(stream), "test", clock=lambda: now)
        for passed, values in arrived:
            now += passed
            found.append(signal.level(values))
        return found

    of_range(np.array(tried(levels) or [1]))


@inputs(0.05)
@given(
    times=st.one_of(
        st.lists(st.floats(), max_size=4),
        st.lists(st.floats(0.1, 1e9), max_size=4, unique=True).map(lambda each: [0.0, *sorted(each)]),
    ),
    levels=st.lists(st.one_of(st.integers(), st.integers(1, 10)), max_size=5),
)
def test_no_schedule_crashes_and_its_levels_are_of_the_range(times: list[float], levels: list[int]) -> None:
    found = tried(
        lambda: make_source(
            replace(COMFORT, source="schedule", schedule_s=times, schedule_levels=levels), len(TIMES)
        ).at(TIMES)
    )
    if found is not None:
        of_range(found)


# ---- what the subtasks see -----------------------------------------------------------------------------

SIZES = {
    "joint_pos": (6,), "joint_vel": (6,), "joint_target": (6,), "joint_home": (6,), "points": (2, 3),
    "human_pos": (2,), "human_seen": (2,), "human_yaw": (), "take": (), "leave": (), "home_tolerance": (),
    "arm_distance": (), "level": (), "balls": (1, 3),
}  # fmt: skip
"""Of a row of each field of `State`; the others are points."""
FLAGS = ("human_collision", "table_collision", "self_collision")
ROWS = 4


def random_state(rng: np.random.Generator, exponents: tuple[int, int]) -> State:
    """Return a state of finite numbers of such powers of ten, among them some zeros and some the same."""

    def numbers_of(size: tuple[int, ...]) -> torch.Tensor:
        scale = 10.0 ** rng.uniform(*sorted(exponents), (ROWS, *size))
        kept = rng.random((ROWS, *size)) > 0.2
        return torch.from_numpy(rng.choice([-1.0, 1.0], (ROWS, *size)) * scale * kept)

    whole: dict[str, torch.Tensor] = {
        "colour": torch.from_numpy(rng.integers(2, size=ROWS)),
        "colours": torch.from_numpy(rng.integers(2, size=(ROWS, 1))),
        "placed": torch.from_numpy(rng.random((ROWS, 1)) < 0.5),
        "target": torch.zeros(ROWS, dtype=torch.int64),
        "stage": torch.from_numpy(rng.integers(4, size=ROWS)),
        "steps": torch.from_numpy(rng.integers(10**6, size=ROWS)),
        "level": torch.from_numpy(rng.integers(1, COMFORT.levels + 1, size=ROWS).astype(np.float64)),
        **{name: torch.from_numpy(rng.random(ROWS) < 0.5) for name in FLAGS},
    }
    names = [field.name for field in dataclasses.fields(State)]
    state = State(**{name: whole.get(name, numbers_of(SIZES.get(name, (3,)))) for name in names})
    if rng.random() < 0.3:
        away = torch.tensor([[FAR_AWAY_M, 0.0]], dtype=torch.float64).expand(ROWS, 2)
        return state.with_(human_pos=away, human_seen=away, arm_distance=torch.full((ROWS,), math.nan))
    return state.with_(human_pos=state.tcp_pos[:, :2].clone()) if rng.random() < 0.3 else state


@inputs(0.12)
@given(
    seed=st.integers(0, 2**32 - 1),
    exponents=st.tuples(st.integers(-200, 100), st.integers(-200, 100)),
    name=st.sampled_from(sorted(SUBTASKS)),
    layout=st.sampled_from(sorted(LAYOUTS)),
    forms=st.tuples(
        st.sampled_from(sorted(terms.FORMS)),
        st.sampled_from(sorted(terms.THRESHOLDS)),
        st.sampled_from(sorted(terms.SPEED_FORMS)),
        st.sampled_from(allowed.DISTANCES),
    ),
)
def test_no_state_makes_a_subtask_or_a_form_of_comfort_say_what_is_no_number(
    seed: int, exponents: tuple[int, int], name: str, layout: str, forms: tuple[str, str, str, str]
) -> None:
    named = dict(zip(("form", "threshold", "speed_form", "distance"), forms, strict=True))
    config = replace(COMFORT, beta=0.5, **named)
    task = with_comfort(subtask(name, layout), config, max_step_deg=2.0)
    rng = np.random.default_rng(seed)
    before, after = (random_state(rng, exponents) for _ in range(2))
    before, after = (each.with_(stage=each.stage.clamp(max=len(task.stages))) for each in (before, after))

    def said() -> dict[str, torch.Tensor]:
        paid = {f"reward {name}": term(before, after) for name, term in task.rewards.items()}
        seen = {f"observation {name}": term(after) for name, term in task.observations.items()}
        return {**paid, **seen, "success": task.success(after), "failure": task.failure(after)}

    for what, tensor in (tried(said) or {}).items():
        assert tensor.shape[0] == ROWS and tensor.isfinite().all(), what


# ---- what policies are read from -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("policy") / "policy.pt"
    write_policy(file)
    return file


def acted(file: Path) -> torch.Tensor:
    return load_policy(file)(torch.linspace(-10, 10, 12).reshape(3, 4))


@inputs(0.08)
@given(changes=CHANGES)
def test_no_damaged_policy_file_crashes_and_what_is_loaded_acts_in_finite_numbers(
    changes: list[Change], policy: Path, fresh: Callable[[bytes], Path]
) -> None:
    file = fresh(changed(policy.read_bytes(), changes))
    action = tried(lambda: acted(file))
    assert action is None or action.isfinite().all()


THINGS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 9),
    st.just(10**12),
    st.floats(),
    st.text(max_size=3),
    st.lists(st.integers(-1, 9), max_size=3),
    st.dictionaries(st.text(max_size=2), st.integers(), max_size=2),
    st.sampled_from([math.nan, math.inf, -1.0, 1e30, 1e38, 1e300]).map(
        lambda value: torch.full((4,), value, dtype=torch.float64)
    ),
    st.lists(st.integers(0, 9), max_size=3).map(torch.zeros),
)


def paths(tree: Any) -> list[tuple[str, ...]]:
    """Return where something can be put into nested dicts."""
    found: list[tuple[str, ...]] = []
    for key, value in tree.items():
        found += (
            [(key,), *((key, *rest) for rest in paths(value) if isinstance(value, dict))]
            if isinstance(value, dict)
            else [(key,)]
        )
    return found


def with_something_else(
    content: dict[str, Any], which: int, thing: Any, gone: bool, scale: float, fresh: Callable[[bytes], Path]
) -> Path:
    """Return a file of `content` where one thing is gone, of other size, or something else."""
    state = copy.deepcopy(content)
    *above, last = paths(state)[which % len(paths(state))]
    tree = state
    for name in above:
        tree = tree[name]
    if gone:
        del tree[last]
    elif isinstance(tree[last], torch.Tensor) and scale != 1:
        tree[last] = tree[last] * scale
    else:
        tree[last] = thing
    file = io.BytesIO()
    torch.save(state, file)
    return fresh(file.getvalue())


CHANGED = {
    "which": st.integers(0, 100), "thing": THINGS, "gone": st.booleans(),
    "scale": st.sampled_from([1, 1e20, -1e38]),
}  # fmt: skip


@inputs(0.05)
@given(**CHANGED)
def test_no_policy_file_with_other_things_in_it_crashes(
    which: int, thing: Any, gone: bool, scale: float, policy: Path, fresh: Callable[[bytes], Path]
) -> None:
    file = with_something_else(checkpoint.load(policy), which, thing, gone, scale, fresh)
    action = tried(lambda: acted(file))
    assert action is None or action.isfinite().all()


OPTIONS = ["pick_1", "place", "return", "wait", "retreat"]


@pytest.fixture(scope="module")
def controller(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    agent = replace(compose("train_meta").meta_agent, hidden=[4], buffer_size=1, batch_size=1)
    file = tmp_path_factory.mktemp("controller") / "meta.pt"
    learner = QLearner(agent, OTHERS + BALL, len(OPTIONS), seed=0)
    learner.save(file, {"levels": COMFORT.levels, "balls": 1, "names": OPTIONS})
    return checkpoint.load(file)


@inputs(0.05)
@given(**CHANGED)
def test_no_controllers_file_with_other_things_in_it_crashes_and_what_is_loaded_chooses_what_can_start(
    which: int,
    thing: Any,
    gone: bool,
    scale: float,
    controller: dict[str, Any],
    fresh: Callable[[bytes], Path],
) -> None:
    file = with_something_else(controller, which, thing, gone, scale, fresh)
    rng = np.random.default_rng(which)
    mask = torch.from_numpy(rng.random((ROWS, len(OPTIONS))) < 0.5)
    mask[:, WAIT] = True
    decision = Decision(random_state(rng, (-3, 1)), mask, waits=torch.zeros(ROWS, dtype=torch.int64))
    chosen = tried(lambda: load_choice(str(file), COMFORT.levels, OPTIONS)(decision))
    assert chosen is None or mask[torch.arange(ROWS), chosen].all()
