"""Trainings that share a batched update are those that they would be alone."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import pytest
import torch
from torch import Tensor

from hrl_comfort import __main__ as commands
from hrl_comfort.agents import checkpoint
from hrl_comfort.agents.sac import Sac, TrainingDiverged
from hrl_comfort.agents.together import Diverged, Together
from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.experiments import train_together as module
from hrl_comfort.experiments.preemption import Preempted
from hrl_comfort.experiments.stepper import Stepper
from hrl_comfort.experiments.sweep_record import find_jobs
from hrl_comfort.experiments.train import train
from hrl_comfort.experiments.train_cell import train_cell, train_cells
from hrl_comfort.experiments.train_together import Turn, Why, train_together
from hrl_comfort.experiments.training_log import claim
from tests.point_env import make_points, small_config
from tests.test_sac import A, D, agent, filled


def stopped_of(found: Iterable[tuple[int, Why]]) -> dict[int, Why]:
    """What stopped those that did not get to the end, when all have ended."""
    return {index: why for index, why in found if why is not None}


CLOSE = {"rtol": 1e-3, "atol": 1e-5}
"""Products are summed in another order."""


def learners(*seeds: int, **changes: object) -> list[Sac]:
    found = []
    for seed in seeds:
        torch.manual_seed(seed)
        found.append(filled(Sac(agent(**changes), D, A)))
    return found


def tensors(learner: Sac) -> list[Tensor]:
    """Everything that an update changes."""
    states = [learner.optimiser.state[each] for each in learner._parameters]
    moments = [state[name] for state in states for name in ("step", "exp_avg", "exp_avg_sq")]
    parameters = (learner._parameters, learner._target_parameters, learner._average_parameters)
    return [*(each for group in parameters for each in group), *moments]


@pytest.mark.parametrize("first", [0, 3])
def test_learners_updated_together_become_what_they_become_alone(first: int) -> None:
    changes = {"actor_tau": 0.1, "critic_first_updates": 2}
    alone, others = learners(0, 1, 2, **changes), learners(0, 1, 2, **changes)
    for one in [*alone, *others]:
        for _ in range(first):
            one.update()
    together = Together(others)
    for _ in range(5):
        expected = [one.update() for one in alone]
        for terms, wanted in zip(together.update(), expected, strict=True):
            assert terms == pytest.approx(wanted, rel=1e-3, abs=1e-5)
    for one, other in zip(alone, others, strict=True):
        one.update(), other.update()  # alone again
        torch.testing.assert_close(tensors(other), tensors(one), **CLOSE)
        assert other.updates == one.updates == first + 6


def test_a_file_of_one_of_them_holds_nothing_of_the_others(tmp_path: Path) -> None:
    (alone,), others = learners(0), learners(0, 1, 2, 3)
    alone.update()
    Together(others).update()
    for name, learner in (("alone", alone), ("one", others[0])):
        checkpoint.save(tmp_path / name, learner.state_dict())
    assert (tmp_path / "one").stat().st_size <= 1.01 * (tmp_path / "alone").stat().st_size
    again = learners(7)[0]
    again.buffer.empty()
    again.load_state_dict(checkpoint.load(tmp_path / "one"))
    torch.testing.assert_close(tensors(again), tensors(others[0]), rtol=0, atol=0)


def test_the_replay_buffer_of_a_checkpoint_is_its_filled_part(tmp_path: Path) -> None:
    (learner,) = learners(0, buffer_size=100_000)
    checkpoint.save(tmp_path / "c.pt", learner.state_dict())
    assert (tmp_path / "c.pt").stat().st_size < 200_000


def test_learners_that_differ_are_not_taken_for_one() -> None:
    with pytest.raises(ValueError, match="several kinds"):
        Together([*learners(0), *learners(1, batch_size=8)])
    ahead, behind = learners(0, 1)
    ahead.update()
    with pytest.raises(ValueError, match="several kinds"):
        Together([ahead, behind])


def test_one_that_diverges_is_named_and_the_others_are_left_as_they_were() -> None:
    first, second = learners(0, 1)
    with torch.no_grad():
        second.critics.weights[0].fill_(math.inf)
    before = [each.clone() for each in first._parameters]
    with pytest.raises(Diverged, match="training diverged at update 0: critic_loss") as raised:
        Together([first, second]).update()
    assert raised.value.learner is second
    assert all(torch.equal(each, was) for each, was in zip(first._parameters, before, strict=True))
    assert first.update() == learners(0)[0].update(), "it has drawn nothing either"


# ---- trainings -----------------------------------------------------------------------------------------


def metrics(folder: Path) -> list[list[float]]:
    with (folder / "metrics.csv").open(newline="") as file:
        return [[float(cell or "nan") for cell in row] for row in list(csv.reader(file))[1:]]


def configs(folder: Path, *overrides: str) -> list[TrainConfig]:
    return [
        small_config(folder / str(seed), *overrides, f"train_seed={seed}", f"episode_seed={seed}")
        for seed in range(3)
    ]


SHORT = "agent.decisions=600"
"""Rounding grows: an action that differs in its last digit ends another episode in the end."""


def test_trainings_together_are_those_alone(tmp_path: Path) -> None:
    assert stopped_of(train_together(configs(tmp_path / "together", SHORT), make_points)) == {}
    for config in configs(tmp_path / "alone", SHORT):
        folder = train(config, make_points)
        other = tmp_path / "together" / folder.name
        torch.testing.assert_close(metrics(other), metrics(folder), rtol=1e-2, atol=1e-3, equal_nan=True)
        names = {path.name for path in folder.rglob("*") if not path.name.startswith("events")}
        assert names == {path.name for path in other.rglob("*") if not path.name.startswith("events")}


def test_what_stops_one_of_them_does_not_stop_the_others(tmp_path: Path) -> None:
    def make(config: TrainConfig) -> Stepper:
        return make_points(config, stop_after=40 if config.train_seed == 1 else None)

    taken = tmp_path / "2"
    train(small_config(taken, SHORT), make_points)
    stopped = stopped_of(train_together(configs(tmp_path, SHORT), make))
    assert {index: type(why).__name__ for index, why in stopped.items()} == {1: "Stopped", 2: "ConfigError"}
    assert len(metrics(tmp_path / "0")) == 3


def test_one_that_diverges_among_trainings_is_reported_and_the_others_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Diverging(Together):
        def update(self) -> list[dict[str, float]]:
            if len(self.learners) == 3 and self.learners[0].updates == 5:
                raise Diverged(self.learners[1], "training diverged at update 5: alpha is nan")
            return super().update()

    monkeypatch.setattr(module, "Together", Diverging)
    stopped = stopped_of(train_together(configs(tmp_path, SHORT), make_points))
    assert list(stopped) == [1]
    assert isinstance(stopped[1], TrainingDiverged)
    assert all(len(metrics(tmp_path / name)) == 3 for name in "02")


def test_what_breaks_the_update_they_share_ends_them_all_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: Together) -> list[dict[str, float]]:
        raise RuntimeError("out of memory")

    monkeypatch.setattr(Together, "update", full)
    asked = [*configs(tmp_path, SHORT), small_config(tmp_path / "3", SHORT, "agent.hidden=[16]")]
    stopped = stopped_of(train_together(asked, make_points))
    assert {index: str(why) for index, why in stopped.items()} == dict.fromkeys(range(3), "out of memory")
    assert len(metrics(tmp_path / "3")) == 3


def test_those_told_to_stop_go_on_alone_or_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = configs(tmp_path / "whole", SHORT)
    assert stopped_of(train_together(whole, make_points)) == {}
    calls = iter(range(1_000_000))

    def asked() -> AbstractContextManager[Callable[[], bool]]:
        return nullcontext(lambda: next(calls) >= 52)

    with monkeypatch.context() as patched:
        patched.setattr(module, "asked_to_stop", asked)
        stopped = stopped_of(train_together(configs(tmp_path, SHORT), make_points))
    assert [type(why) for why in stopped.values()] == [Preempted] * 3
    folders = [tmp_path / str(seed) for seed in range(3)]
    first, *others = [small_config(folder, resume=str(folder)) for folder in folders]
    train(first, make_points)
    assert stopped_of(train_together(others, make_points)) == {}
    for folder in folders:
        expected = metrics(tmp_path / "whole" / folder.name)
        torch.testing.assert_close(metrics(folder), expected, rtol=1e-2, atol=1e-3, equal_nan=True)


def test_those_that_cannot_share_an_update_take_turns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    groups = []

    class Counted(Together):
        def __init__(self, those: list[Sac]) -> None:
            groups.append(len(those))
            super().__init__(those)

    monkeypatch.setattr(module, "Together", Counted)
    asked = configs(tmp_path, SHORT)
    asked.append(small_config(tmp_path / "3", SHORT, "agent.hidden=[16]"))
    assert stopped_of(train_together(asked, make_points)) == {}
    assert groups == [3]
    assert all(len(metrics(tmp_path / str(index))) == 3 for index in range(4))


# ---- the command ---------------------------------------------------------------------------------------


TINY = (
    "task=reach", "agent.decisions=24", "agent.warmup_decisions=8", "agent.hidden=[8]", "agent.batch_size=4",
    "agent.buffer_size=50", "agent.log_every=8", "agent.checkpoint_every=8", "engine.rows=2",
)  # fmt: skip


def test_a_sweep_is_trained_together_and_does_what_is_left(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["train", "-m", "--together", *TINY, "train_seed=0,1", f"output='{tmp_path}'"]
    assert commands.main([*words, "initial_policy=null,/no/policy"]) == 1
    out = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in out] == ["done", "failed", "done", "failed"]
    assert "/no/policy" in out[1]
    assert [job.state for job in find_jobs(tmp_path).values()] == ["done", "failed", "done", "failed"]
    assert commands.main([*words, "initial_policy=null,/no/policy"]) == 1
    out = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in out] == ["skipped, finished", "failed"] * 2


def test_a_sweep_told_to_stop_says_where_each_of_its_trainings_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(those: list[TrainConfig], turn: Turn) -> list[tuple[int, Why]]:
        assert [turn(index, config) for index, config in enumerate(those)] == those
        return [(0, Preempted("stopped by SIGTERM")), (1, ConfigError("no room")), (2, None)]

    monkeypatch.setattr("hrl_comfort.experiments.train_cell.train_cells", stopped)
    words = ["train", "-m", "--together", *TINY, "train_seed=0,1,2", f"output='{tmp_path}'"]
    assert commands.main(words) == 143
    assert [job.state for job in find_jobs(tmp_path).values()] == ["stopped", "failed", "done"]


def test_what_another_command_has_done_meanwhile_is_not_done_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def later(those: list[TrainConfig], turn: Turn) -> list[tuple[int, Why]]:
        train_cell(those[1])
        return [*train_cells(those, turn)]

    monkeypatch.setattr("hrl_comfort.experiments.train_cell.train_cells", later)
    words = ["train", "-m", "--together", *TINY, "train_seed=0,1", f"output='{tmp_path}'"]
    assert commands.main(words) == 0
    out = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in out] == ["done", "skipped, finished"]
    assert [job.state for job in find_jobs(tmp_path).values()] == ["done", "done"]


def test_the_folder_of_one_that_failed_is_free_while_the_others_go_on(tmp_path: Path) -> None:
    def make(config: TrainConfig) -> Stepper:
        return make_points(config, stop_after=40 if config.train_seed == 1 else None)

    found = train_together(configs(tmp_path, SHORT), make)
    assert next(found)[0] == 1
    first_end = next(found)[0]
    assert first_end in (0, 2)
    with claim(tmp_path / "1", resume=True):
        pass
    assert [index for index, _ in found] == [2 - first_end]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["train", "--together"], "--together goes with -m"),
        (["evaluate", "-m", "--together", "policy=a,b"], "evaluate cannot be run --together; train can"),
        (["train", "-m", "--together", "hydra/launcher=joblib"], "hydra/launcher=joblib does not go with"),
        (["train", "-m", "--together", "hydra/sweeper=optuna"], "hydra/sweeper=optuna does not go with"),
    ],
)
def test_what_cannot_go_together_is_said_in_one_line(
    words: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert commands.main(words) == 1
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1
