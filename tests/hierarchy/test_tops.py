"""Every top keeps to one contract, built in or a user's: it chooses what can start, row by row, and begins anew."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hrl_comfort.agents.learners import TOPS as LEARNERS
from hrl_comfort.agents.tops.discrete_sac import DiscreteSAC
from hrl_comfort.agents.tops.dqn import DQN
from hrl_comfort.agents.tops.ppo import PPO
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig
from hrl_comfort.config.checks import plugins
from hrl_comfort.config.hierarchy import LOOKAHEAD, ORACLE
from hrl_comfort.config.overrides import choices
from hrl_comfort.deploy.export import export
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.files.run_config import environment
from hrl_comfort.hierarchy.controllers import make_executor
from hrl_comfort.hierarchy.decision import Decision, Top
from hrl_comfort.hierarchy.executor import OptionExecutor, execute
from hrl_comfort.hierarchy.learned import save_controller
from hrl_comfort.hierarchy.observation import observation_dim
from hrl_comfort.hierarchy.options import Begun, Choice, Option, OptionTable, lasts
from hrl_comfort.hierarchy.tops import TOPS
from hrl_comfort.humans import split_set
from hrl_comfort.sim.engine import Engine
from hrl_comfort.studio.session import Session
from hrl_comfort.studio.web.content import refuse
from hrl_comfort.tasks import State

ROWS = 6
NAMES = {learner: name for name, learner in LEARNERS.items()}
SKILLS = [f"policies.{name}=random" for name in ("pick", "place", "return")]
PAGE = Path(__file__).parents[2] / "docs" / "bring_your_own.md"
SNIPPETS = dict(re.findall(r"```python\n# (\w+)\.py\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL))
MODULE = """
import torch

BEGUN = []

def first(decision):
    return decision.mask.int().argmax(dim=1).tolist()

class Turns:
    def begin(self, rows):
        BEGUN.append(rows.tolist())

    def choose(self, decision):
        return first(decision)

def halves(decision):
    return decision.mask[:, 0] / 2

def short(decision):
    return [0]

def last(decision):
    return [len(decision.table) - 1] * len(decision.mask)

def beyond(decision):
    return torch.full((len(decision.mask),), 99)

class Counting:
    quantity = "objects"

    def choose(self, decision):
        return first(decision)

    def values(self, decision):
        return decision.table.object.expand(decision.mask.shape).tolist()

class Short(Counting):
    def values(self, decision):
        return [0.5]

class Wordy(Counting):
    def values(self, decision):
        return "none"

class Data(Counting):
    values = {"pick_1": 0.5}

class Early(Turns):
    def begin(self):
        pass

def pair(decision, other):
    return first(decision)

NOBODY = 3
"""


@pytest.fixture(autouse=True)
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Install the package `deciders`, which offers a top as an entry point, and the top of the documentation."""
    (tmp_path / "deciders.py").write_text(MODULE, encoding="utf-8")
    (tmp_path / "away.py").write_text(SNIPPETS["away"], encoding="utf-8")
    info = tmp_path / "deciders-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: deciders\nVersion: 1.0\n", encoding="utf-8")
    points = "[hrl_comfort.meta_controller.name]\nturns = deciders:Turns\n"
    (info / "entry_points.txt").write_text(points, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    plugins.cache_clear()
    yield
    for name in ("deciders", "away"):
        sys.modules.pop(name, None)
    plugins.cache_clear()


def under(name: str) -> list[str]:
    """Return overrides for the top `name`, which may give a skill two levels unless it gives none."""
    levels = [] if name == "idle" else ["meta_controller.level_override=[10,3]"]
    return [f"meta_controller={name}", "comfort=sort", *levels]


def config(name: str, *overrides: str, folder: Path | None = None, learner: type = DQN) -> EvaluateConfig:
    """Return an evaluation under the top `name`; a learned one is written to `folder`."""
    words = [*under(name), *overrides]
    if name == "learned":
        assert folder is not None
        words.append(f"policies.meta_controller='{folder}'")
    found = compose("evaluate", ["task=sort", "task.objects=3", "split=validation", *SKILLS, *words])
    assert isinstance(found, EvaluateConfig)
    if name == "learned":
        names = executor(config("nearest", *overrides))[0].table.names
        words = [f"meta_controller_agent={NAMES[learner]}", "meta_controller_agent.hidden=[8]"]
        agent = compose("train_meta_controller", words).meta_controller_agent
        spec = {"names": names, "levels": 10, "objects": 3, "max_waits": None}
        width = observation_dim(agent.observation, 3)
        save_controller(folder / "meta_controller.pt", learner(agent, width, len(names)), agent, width, spec)
    return found


def executor(asked: EvaluateConfig, seed: int = 0) -> tuple[OptionExecutor, Top, State]:
    engine = Engine(environment(asked), ROWS, 0)
    state = engine.reset()
    return *make_executor(asked, None, engine, seed), state


def decisions(asked: EvaluateConfig) -> tuple[Top, list[Decision]]:
    """Return the top, and decisions at each stage of a round, with people far away and near, at home and astray."""
    made, top, state = executor(asked)
    found = []
    for stage in range(4):
        for people in (state.humans_pos, state.objects[:, :1, :2]):
            here = state.with_(stage=torch.full((ROWS,), stage), humans_pos=people)
            found.append(made.decision(here))
    made._preempted[:] = True
    return top, [*found, made.decision(state.with_(joint_pos=state.joint_home + 0.5))]


def test_every_top_is_a_choice_of_its_group() -> None:
    assert set(choices("meta_controller")) == {"none", ORACLE, LOOKAHEAD, *TOPS}


@pytest.mark.parametrize("name", [*TOPS, "deciders:first", "deciders:Turns", "turns", "away:away"])
def test_a_top_chooses_what_can_start_in_each_row_by_itself(name: str, tmp_path: Path) -> None:
    asked = config(name, folder=tmp_path)
    top, given = decisions(asked)
    chosen = [top(each) for each in given]
    for each, choice in zip(given, chosen, strict=True):
        assert each.mask.gather(1, choice[:, None]).all() and choice.dtype == torch.int64
    again, _ = decisions(asked)
    assert all(torch.equal(again(each), choice) for each, choice in zip(given, chosen, strict=True))
    if name != "random":
        for each, choice in zip(given, chosen, strict=True):
            turned = replace(each, state=each.state.rows(torch.arange(ROWS).flip(0)), mask=each.mask.flip(0))
            assert torch.equal(top(turned).flip(0), choice)


@pytest.mark.parametrize("name", [*TOPS, "deciders:Turns", "away:away"])
def test_a_top_works_through_episodes_in_evaluation_and_studio(name: str, tmp_path: Path) -> None:
    asked = config(name, "human=none", "task.max_episode_steps=60", "episodes=2", folder=tmp_path)
    result = rollout(asked)
    assert len(result.episodes) == 2 and {row.policy for row in result.episodes} == {f"meta_controller={name}"}
    learned = [f"policies.meta_controller='{tmp_path}'"] if name == "learned" else []
    words = ["task=sort", "human=still", "task.objects=3", *under(name), *SKILLS, *learned]
    session = Session(compose("studio", words))  # type: ignore[arg-type]
    assert session.step().clip.duration_s > 0 and session.option in session.options
    session.close()


def test_the_top_of_the_documentation_is_short_and_takes_what_is_farthest_from_people() -> None:
    assert len(SNIPPETS["away"].splitlines()) <= 15
    top, (first, *_) = decisions(config("away:away"))
    gap = (first.state.objects[..., :2] - first.state.humans_pos[:, :1]).norm(dim=-1)
    assert torch.equal(first.table.object[top(first)], gap.argmax(dim=1))


def test_a_top_with_a_memory_is_told_where_an_episode_begins() -> None:
    rollout(config("turns", "human=none", "task.max_episode_steps=40", "episodes=3"))
    assert sys.modules["deciders"].BEGUN == [[True] * 3]


@pytest.mark.parametrize("skills", [SKILLS, ["division=one", "policies.cycle=random"]])
def test_a_chain_takes_any_top_that_needs_no_option_of_its_own(skills: list[str]) -> None:
    for name in ("fixed", "random", "deciders:first"):
        words = [
            *skills,
            "task=cycle",
            f"meta_controller={name}",
            "human=none",
            "episodes=2",
            "task.max_episode_steps=40",
        ]
        assert len(rollout(compose("evaluate", words)).episodes) == 2  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("deciders:halves", r"returned float32 of shape \(6,\); it must return 6 indices of options"),
        ("deciders:short", r"returned int64 of shape \(1,\); it must return 6 indices of options"),
        ("deciders:last", r"chose 'retreat' in row 0, which cannot start now; pick_1, pick_2, pick_3, pick_1_as_10, "),
        ("deciders:beyond", "chose 99 in row 0, which cannot start now; "),
        ("deciders:pair", r" must be a function of decision; its own are \(decision, other\): missing a required"),
        ("deciders:Early", r": begin must be a function of rows; its own are \(\): too many positional"),
        ("deciders:NOBODY", "is of type int; it must be callable or have choose"),
        ("deciders:nobody", r": .*deciders.py has no nobody"),
        ("nowhere:choose", "cannot be imported: No module named 'nowhere'"),
    ],
)
def test_a_top_that_breaks_the_contract_gets_one_line(name: str, message: str) -> None:
    def asked() -> None:
        made, top, state = executor(config(name))
        top(made.decision(state))

    with pytest.raises(ConfigError, match=f"^meta_controller.name='{name}':? ?{message}"):
        asked()


def test_a_page_and_onnx_files_say_that_they_carry_no_top(tmp_path: Path) -> None:
    page = compose("studio", ["task=cycle", "meta_controller=deciders:first", *SKILLS])
    with pytest.raises(ConfigError, match=r"^meta_controller=deciders:first: a page .* carries no controller$"):
        refuse(page)  # type: ignore[arg-type]
    files = compose("export", [f"policies.meta_controller='{tmp_path}'", *SKILLS, f"output='{tmp_path / 'out'}'"])
    with pytest.raises(ConfigError, match=r"^policies\.meta_controller: export writes skills, .*; leave it out$"):
        export(files)  # type: ignore[arg-type]


@pytest.mark.parametrize(("learner", "quantity"), [(DQN, "value"), (PPO, "probability"), (DiscreteSAC, "probability")])
def test_a_learned_top_says_what_it_thinks_of_the_options_that_can_start(
    learner: type, quantity: str, tmp_path: Path
) -> None:
    top, given = decisions(config("learned", folder=tmp_path, learner=learner))
    assert top.quantity == quantity
    for each in given:
        values = top.values(each)
        assert values is not None and torch.equal(values.argmax(dim=1), top(each))
        assert (values[~each.mask] == (0.0 if quantity == "probability" else -torch.inf)).all()
        assert quantity != "probability" or torch.allclose(values.sum(dim=1), torch.ones(ROWS, dtype=torch.float64))


def test_a_top_of_a_user_may_say_what_it_thinks_of_the_options_and_a_rule_says_nothing() -> None:
    top, (first, *_) = decisions(config("deciders:Counting"))
    values = top.values(first)
    assert top.quantity == "objects" and values is not None and torch.equal(values[0], first.table.object.double())
    for name in ("nearest", "deciders:first", "deciders:Data"):
        top, (first, *_) = decisions(config(name))
        assert top.values(first) is None
    for name, said in ("Short", r"shape \(1,\)"), ("Wordy", "str"):
        top, (first, *_) = decisions(config(f"deciders:{name}"))
        with pytest.raises(ConfigError, match=rf"'deciders:{name}': values returned {said}; it must return 6 x \d+ n"):
            top.values(first)


def test_what_is_chosen_where_no_option_has_ended_is_ignored() -> None:
    made, _, state = executor(config("nearest"))
    some = torch.arange(ROWS) < 3
    top = Top("some", lambda decision: torch.where(decision.deciding, 1, -7))
    assert top(made.decision(state, some))[some].tolist() == [1, 1, 1]


def test_a_fixed_choice_follows_its_order_and_then_the_numbers() -> None:
    made, top, state = executor(config("fixed", "meta_controller.order=[pick_2_as_3,wait]"))
    table, placed = made.table, state.placed.clone()
    assert {table.names[k] for k in top(made.decision(state)).tolist()} == {"pick_2_as_3"}
    placed[:, 1] = True
    assert {table.names[k] for k in top(made.decision(state.with_(placed=placed))).tolist()} == {"wait"}
    plain, top, _ = executor(config("fixed"))
    assert {table.names[k] for k in top(plain.decision(state)).tolist()} == {"pick_1_as_10"}
    with pytest.raises(ConfigError, match=r"^meta_controller.order='pick_4' is not allowed; choose one of pick_1, "):
        executor(config("fixed", "meta_controller.order=[pick_4]"))


def test_patience_grows_as_the_level_falls() -> None:
    made, top, state = executor(config("patient"))
    wait = made.table.position("wait")
    beside = state.objects[:, :1, :2] + torch.tensor([0.45, 0.0])  # half of the distance at level 1
    waits = []
    for level in (1.0, 4.0, 9.0, 10.0, torch.nan):
        here = state.with_(humans_pos=beside, level=torch.full((ROWS,), level, dtype=torch.float64))
        waits.append(bool((top(made.decision(here)) == wait).all()))
    assert waits == [True, True, False, False, True]
    holding = state.with_(humans_pos=beside, stage=torch.ones(ROWS, dtype=torch.int64))
    assert not (top(made.decision(holding)) == wait).any()


def test_idle_waits_wherever_it_can_and_else_goes_home() -> None:
    made, top, state = executor(config("idle"))
    asked, wait = made.decision(state), made.table.position("wait")
    assert (top(asked) == wait).all()
    away = torch.zeros_like(asked.mask)
    away[:, retreat := made.table.position("retreat")] = True
    assert (top(replace(asked, mask=away)) == retreat).all()


def test_a_termination_may_be_a_probability_and_is_drawn_by_episode_and_step() -> None:
    engine = Engine(environment(config("nearest")), 64, 0)
    state = engine.reset()
    option = Option(
        "drift", lambda s: torch.zeros_like(s.joint_pos), lambda s: s.steps >= 0, lambda s, _: s.steps * 0.0 + 0.3
    )
    made = OptionExecutor(OptionTable([option]), engine.episodes)
    found, rows = made._ends(0, state), torch.tensor([40, 7])
    assert torch.equal(found, made._ends(0, state)) and 5 <= int(found.sum()) <= 35
    alone = OptionExecutor(OptionTable([option]), engine.episodes).copies(engine.copies(rows).episodes, rows)
    assert torch.equal(alone._ends(0, state.rows(rows)), found[rows])
    later = state.with_(steps=state.steps + 1)
    assert not torch.equal(found, made._ends(0, later)) and not torch.equal(found, made._ends(0, engine.reset()))


def test_ends_that_are_drawn_do_not_depend_on_neighbours() -> None:
    option = Option(
        "drift", lambda s: torch.zeros_like(s.joint_pos), lambda s: s.steps >= 0, lambda s, _: s.steps * 0.0 + 0.1
    )
    chosen = config("nearest", "task.max_episode_steps=200", "human=none")
    entries, runs = split_set("validation", 6), []
    for rows in ([0, 1, 2, 3, 4, 5], [4]):
        engine = Engine(environment(chosen), len(rows), 0, entries.at(np.array(rows)))
        executor = OptionExecutor(OptionTable([option]), engine.episodes)
        engine.reset()
        steps = execute(engine, executor, Top("first", lambda decision: torch.zeros(len(decision.mask)).long()))
        runs.append([(run.row, run.start_step, run.end_step) for step in steps for run in step.runs])
    of_four = [run[1:] for run in runs[0] if run[0] == 4]
    assert of_four == [run[1:] for run in runs[1]] and len(of_four) > 3
    assert of_four != [run[1:] for run in runs[0] if run[0] == 3]


def test_a_controllers_training_of_before_the_options_were_values_goes_on() -> None:
    made, _, _ = executor(config("nearest"))
    made.begin(torch.ones(ROWS, dtype=torch.bool), torch.zeros(ROWS, dtype=torch.int64))
    before = {name: value for name, value in made.state_dict().items() if name not in ("stage", "generator")}
    after, _, _ = executor(config("nearest"))
    after.load_state_dict({**before, "_first": torch.zeros(ROWS, dtype=torch.int64), "_last": after.stage + 1})
    assert all(torch.equal(value, made.state_dict()[name]) for name, value in after.state_dict().items())


def test_a_table_names_its_choices_by_their_arguments() -> None:
    option = Option("go", lambda s: s.joint_pos, lambda s: s.steps >= 0, lasts(5), max_runs=1)
    table = OptionTable([option, Choice(option, 0), Choice(option, 0, 6)])
    assert table.names == ["go", "go_1", "go_1_as_6"] and len(table.options) == 1
    assert table.position("go_1") == 1 and table.object.tolist() == [-1, 0, 0]
    begun = Begun(torch.zeros(2, dtype=torch.int64), torch.tensor([4, 5]))
    assert lasts(5)(State.of(), begun).tolist() == [False, True]
    with pytest.raises(ConfigError, match="there is no option 'wait'; choose one of go, go_1, go_1_as_6"):
        table.position("wait")
    with pytest.raises(ValueError, match="names of their own"):
        OptionTable([option, option])
