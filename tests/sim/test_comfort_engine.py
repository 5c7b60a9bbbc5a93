"""Comfort in the episodes: who sees which level when, what it pays, and that nothing else changes."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from hrl_comfort.comfort.sources import Live
from hrl_comfort.comfort.terms import FORMS
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.envs.dm import make_environment
from hrl_comfort.envs.torchrl import CellEnv
from hrl_comfort.files.run_config import environment
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.streams import UdpStream

CHANGING = ("comfort=conditioned", "comfort.source=changing", "comfort.change_s=0.3")


def configured(*overrides: str) -> EnvConfig:
    return environment(compose("train", ["task=pick", *overrides]))


def begun(*overrides: str, rows: int = 6, seed: int = 0) -> Engine:
    engine = Engine(configured(*overrides), rows, seed)
    engine.reset()
    return engine


def actions(rows: int, count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (count, rows, 6))


def by_row(outcome: StepResult, name: str) -> Tensor:
    """Return a field of the instants, (N, K, ...)."""
    value: Tensor = getattr(outcome.instants, name)
    return value.expand(*outcome.valid.shape, *value.shape[2:])


def paid(engine: Engine, outcome: StepResult) -> Tensor:
    """Return the comfort column (N,) of the weighted terms."""
    return outcome.reward_terms[:, engine.episodes.reward_names.index("comfort")]


# ---- the level -----------------------------------------------------------------------------------------


def test_a_level_holds_for_a_decision_and_each_row_has_its_own() -> None:
    engine = begun(*CHANGING, rows=12)
    promised, seen = engine.episodes.state.level.clone(), []
    for action in actions(12, 25):
        outcome = engine.step(action)
        levels = by_row(outcome, "level")
        assert (levels == promised[:, None]).all()
        seen.append(levels[:, 0])
        engine.reset(np.flatnonzero(outcome.done.numpy()))
        promised = engine.episodes.state.level.clone()
    levels = torch.stack(seen)
    assert len(levels[0].unique()) > 3
    changes = levels[1:] != levels[:-1]
    assert changes.any(dim=0).all() and not changes.all(dim=1).any()


def test_a_random_level_is_that_of_its_row_whatever_runs_beside_it() -> None:
    few, many = begun("comfort=conditioned", rows=3, seed=5), begun("comfort=conditioned", rows=9, seed=5)
    assert torch.equal(few.episodes.state.level, many.episodes.state.level[:3])
    outcome = few.step(np.zeros((3, 6)))
    assert torch.equal(outcome.state.level, few.episodes.state.level)


def test_the_policy_sees_the_level_from_0_to_1_and_nobody_sees_one_without_a_source() -> None:
    for level, share in ((1, 0.0), (4, 1 / 3), (10, 1.0)):
        engine = begun("comfort=conditioned", "comfort.source=fixed", f"comfort.level={level}")
        observed = engine.episodes.subtask.observe(engine.episodes.state)[:, -1]
        torch.testing.assert_close(observed, torch.full_like(observed, share))
    plain = begun()
    assert plain.episodes.state.level.isnan().all()
    assert "level" not in plain.episodes.subtask.observations


def test_comfort_changes_nothing_else_of_an_episode() -> None:
    variants = [(), ("comfort=conditioned",), CHANGING] + [
        ("comfort=conditioned", "comfort.source=fixed", f"comfort.level={level}") for level in (1, 5, 10)
    ]
    fields = ("humans_pos", "humans_yaw", "target_kind", "joint_pos", "tcp_pos", "steps")
    first: list[list[Tensor]] = []
    for variant in variants:
        engine, told = begun(*variant, "task.max_episode_steps=40"), []
        for action in actions(6, 15):
            outcome = engine.step(action)
            engine.reset(np.flatnonzero(outcome.done.numpy()))
            told.append([getattr(engine.episodes.state, name) for name in fields])
        first = first or told
        for ours, theirs in zip(told, first, strict=True):
            assert all(torch.equal(a, b) for a, b in zip(ours, theirs, strict=True)), variant
    assert engine.episodes.episode.min() > 0, "a row did not begin a second episode"


def test_a_time_limit_that_grows_where_speed_counts_changes_nothing_else_either() -> None:
    plain = begun("task.max_episode_steps=40")
    slow = begun("task.max_episode_steps=40", "comfort=conditioned", "comfort.source=fixed", "comfort.level=1",
                 "comfort.beta=1")  # fmt: skip
    assert slow.episodes.draw.noise.shape[1] > plain.episodes.draw.noise.shape[1]
    for action in actions(6, 7):
        ours, theirs = plain.step(action), slow.step(action)
        for name in ("humans_pos", "target_kind", "tcp_pos"):
            assert torch.equal(getattr(ours.state, name), getattr(theirs.state, name))
    for action in actions(6, 3, seed=1):
        plain.step(action)
        outcome = slow.step(action)
    assert not outcome.truncated.any()


@pytest.mark.parametrize("cut", ["task.action_repeat=1", "task.max_episode_steps=6"])
def test_a_decision_of_one_step_has_a_tool_speed(cut: str, monkeypatch: pytest.MonkeyPatch) -> None:
    engine = begun("comfort=conditioned", "comfort.source=simulated", cut)
    heard, source = [], engine.episodes.source
    monkeypatch.setattr(source, "advance", lambda now: heard.append(now) or source.level)
    tools, counts = [engine.episodes.state.tcp_pos], []
    for _ in range(2):
        outcome = engine.step(np.full((6, 6), 0.5))
        tools.append(outcome.state.tcp_pos)
        counts.append(outcome.decision_steps.numpy())
    assert counts[-1].tolist() == [1] * 6
    for before, after, count, now in zip(tools, tools[1:], counts, heard, strict=False):
        np.testing.assert_allclose(now.speed_m_s, (after - before).norm(dim=-1).numpy() / (0.02 * count))
    assert (heard[-1].speed_m_s > 0.01).all()


def test_the_dm_control_front_sees_the_levels_of_row_0() -> None:
    config = configured(*CHANGING)
    front, engine = make_environment(config, 3), Engine(config, 4, 3)
    seen = [front.reset().observation["level"].item()]
    engine.reset()
    for action in actions(4, 30):
        step, outcome = front.step(action[0]), engine.step(action)
        assert step.observation["level"].item() == pytest.approx((outcome.state.level[0].item() - 1) / 9)
        assert step.reward == pytest.approx(outcome.reward[0].item(), abs=1e-9)
        seen.append(step.observation["level"].item())
        engine.reset(np.flatnonzero(outcome.done.numpy()))
        if step.last():
            front.reset()
    assert len(set(seen)) > 3


def test_a_closed_engine_frees_the_port_of_its_levels() -> None:
    live = ("comfort=conditioned", "comfort.source=udp")
    first = Engine(configured(*live, "comfort.stream.port=0"), 1, 0)
    source = first.episodes.source.levels
    assert isinstance(source, Live) and isinstance(source.stream, UdpStream)
    again = configured(*live, f"comfort.stream.port={source.stream.port}")
    with pytest.raises(ConfigError, match=r"^comfort\.stream\.port=\d+ .* cannot be opened"):
        Engine(again, 1, 0)
    first.close()
    assert source.stream.closed


def test_a_saved_engine_goes_on_with_the_same_levels() -> None:
    first = begun(*CHANGING)

    def advance(engine: Engine, action: np.ndarray) -> list[Tensor]:
        outcome = engine.step(action)
        engine.reset(np.flatnonzero(outcome.done.numpy()))
        return [outcome.reward_terms, outcome.instants.level, engine.episodes.state.level]

    for action in actions(6, 10):
        advance(first, action)
    second = begun(*CHANGING)
    second.load_state_dict(first.state_dict())
    levels = []
    for action in actions(6, 30, seed=1):
        ours, theirs = advance(first, action), advance(second, action)
        assert all(torch.equal(a, b) for a, b in zip(ours, theirs, strict=True))
        levels.append(ours[-1])
    assert (torch.stack(levels).std(dim=0) > 0).all()


# ---- the reward ----------------------------------------------------------------------------------------


def bounded(engine: Engine, outcome: StepResult, arm: bool = False) -> Tensor:
    """Return F_conf1 (N, K) of `form=target_distance` and `threshold=levels`, by hand."""
    config, ease = engine.episodes.config.comfort, (by_row(outcome, "level") - 1) / 9
    span = config.max_m - config.min_m
    tool = (by_row(outcome, "tcp_pos")[..., :2] - by_row(outcome, "humans_pos")[..., 0, :]).norm(dim=-1)
    distance = by_row(outcome, "arm_distance") if arm else tool
    off = ((distance - (config.max_m - span * ease)).abs() / span).clamp(max=1)
    return -off.pow(config.power) - config.time_penalty * ease


def test_terms_add_up_to_the_reward_with_comfort_among_them() -> None:
    env = CellEnv(configured("comfort=conditioned"), 4, 0)
    step = env.rand_step(env.reset())["next"]
    torch.testing.assert_close(step["reward"], step["reward_terms"].sum(-1, keepdim=True))
    assert env.reward_names[-1] == "comfort"
    assert (step["reward_terms"][:, -1] < 0).all()


def test_a_decision_is_paid_scale_times_the_term_of_each_of_its_steps() -> None:
    engine = begun("comfort=conditioned", "comfort.alpha=0.7", "comfort.beta=0.5", "comfort.scale=0.4")
    before = engine.episodes.state
    outcome = engine.step(actions(6, 1)[0])
    near, level = bounded(engine, outcome), by_row(outcome, "level")
    targets = torch.cat([before.joint_target[:, None], by_row(outcome, "joint_target")], dim=1)
    increment = torch.rad2deg(targets.diff(dim=1).abs().amax(dim=-1))
    fast = -(((increment - 2 * level / 10) / 2).clamp(min=0) ** 2)
    by_hand = torch.where(outcome.valid, 0.7 * near + 0.5 * fast, 0.0).sum(dim=1)
    torch.testing.assert_close(paid(engine, outcome), 0.4 * by_hand)
    assert (fast < 0).any() and (near < 0).all()


@pytest.mark.parametrize("form", sorted(FORMS))
def test_a_negative_scale_takes_the_comfort_term_off_as_printed(form: str) -> None:
    added, subtracted = (
        begun("comfort=conditioned", f"comfort.form={form}", f"comfort.scale={scale}") for scale in (1, -1)
    )
    action = actions(6, 1)[0]
    ours, theirs = paid(added, added.step(action)), paid(subtracted, subtracted.step(action))
    assert torch.equal(ours, -theirs) and (ours != 0).any()


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_full_speed_is_free_beside_somebody_wholly_at_ease(sign: float) -> None:
    engine = begun("comfort=conditioned", "comfort.source=fixed", "comfort.level=10", "comfort.alpha=0",
                   "comfort.beta=1", "comfort.speed_form=paper", "comfort.scale=1")  # fmt: skip
    for _ in range(3):
        outcome = engine.step(np.full((6, 6), sign))
        assert (paid(engine, outcome) == 0).all()


def test_nothing_is_paid_for_control_steps_after_an_episode_ended() -> None:
    engine = begun("comfort=conditioned", "comfort.scale=1", "task.max_episode_steps=7")
    engine.step(np.zeros((6, 6)))
    outcome = engine.step(np.zeros((6, 6)))
    assert outcome.decision_steps.tolist() == [2] * 6
    torch.testing.assert_close(paid(engine, outcome), bounded(engine, outcome)[:, :2].sum(dim=1))


def test_distance_of_the_arm_is_paid_for_where_it_is_asked_for() -> None:
    engine = begun("comfort=conditioned", "comfort.distance=arm", "comfort.scale=1")
    assert engine.episodes.state.arm_distance.isfinite().all()
    outcome = engine.step(actions(6, 1)[0])
    by_hand = torch.where(outcome.valid, bounded(engine, outcome, arm=True), 0.0).sum(dim=1)
    torch.testing.assert_close(paid(engine, outcome), by_hand)
    by_tool = begun("comfort=conditioned", "comfort.scale=1")
    assert by_tool.episodes.state.arm_distance.isnan().all()
    assert not torch.allclose(paid(by_tool, by_tool.step(actions(6, 1)[0])), by_hand)


@pytest.mark.parametrize("form", sorted(FORMS))
@pytest.mark.parametrize("distance", ["tool", "arm"])
def test_where_nobody_is_there_comfort_pays_nothing(form: str, distance: str) -> None:
    engine = begun("comfort=conditioned", "human=none", f"comfort.form={form}", "comfort.beta=1",
                   f"comfort.distance={distance}")  # fmt: skip
    outcome = engine.step(actions(6, 1)[0])
    assert (paid(engine, outcome) == 0).all()
    assert outcome.reward.isfinite().all()


@pytest.mark.parametrize(
    ("key", "task", "start"), [("k1", "pick", "pick"), ("k2", "place", "place"), ("k3", "return", "home")]
)
def test_the_factors_of_equation_one_multiply_the_bonuses(key: str, task: str, start: str) -> None:
    plain, doubled = begun(f"task={task}"), begun(f"task={task}", f"reward.{key}=2")
    index = plain.episodes.reward_names.index(start)
    weights = torch.stack([engine.episodes.referee.weights for engine in (plain, doubled)])
    ratio = weights[1] / weights[0]
    assert ratio[index] == 2
    others = torch.arange(weights.shape[1]) != index
    assert torch.equal(weights[1][others], weights[0][others])


def test_an_episode_so_long_that_its_walk_fills_the_memory_is_refused() -> None:
    long = ("comfort.beta=0.5", "comfort.levels=1000", "task.max_episode_steps=100000")
    with pytest.raises(ConfigError, match="is 100000000 control steps at level 1"):
        Engine(configured("comfort=conditioned", *long), 1, 0)
