"""Several balls: where they lie, how they are aimed at, and who decides which comes next."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from hrl_comfort.agents import checkpoint
from hrl_comfort.config import ConfigError, EnvConfig, EvaluateConfig, MetaControllerTrainConfig
from hrl_comfort.config.compose import compose, environment, save_config
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.files.run_folder import find_runs
from hrl_comfort.hierarchy import sort as sorting_module
from hrl_comfort.hierarchy.controllers import make_executor
from hrl_comfort.hierarchy.executor import TERMINATIONS, Decision, OptionExecutor, execute
from hrl_comfort.hierarchy.meta_controllers import RETREAT, WAIT, at_random, cautious, nearest
from hrl_comfort.hierarchy.observation import PERSON, meta_observation, observation_dim
from hrl_comfort.hierarchy.option_env import OptionEnv
from hrl_comfort.hierarchy.options import Termination, act
from hrl_comfort.hierarchy.q_learning import QLearner, load_choice
from hrl_comfort.hierarchy.sort import sorting_options, stop
from hrl_comfort.sim.engine import Engine
from hrl_comfort.training.controller_trainer import train_meta_controller

META = compose("evaluate", ["task=sort", "meta_controller=scripted"]).meta_controller
EXPERTS = {"pick": "expert", "place": "expert", "return": "expert"}
STILL = {"pick": "random", "place": "random", "return": "random"}


def config(*overrides: str) -> EnvConfig:
    return environment(compose("train", ["task=sort", *overrides]))


@pytest.mark.parametrize("balls", [2, 4, 6])
def test_balls_lie_on_their_table_and_never_overlap(balls: int) -> None:
    env = config(f"task.balls={balls}")
    state = Engine(env, 40, 0).reset()
    offset = state.balls - torch.tensor(env.cell.ball_m, dtype=torch.float64)
    assert (offset[..., :2].abs() <= env.cell.table_half_width_m).all() and (offset[..., 2] == 0).all()
    apart = (state.balls[:, :, None] - state.balls[:, None]).norm(dim=-1) + 9 * torch.eye(balls)
    assert (apart >= 2 * env.cell.ball_radius_m - 1e-9).all()
    assert state.colours.unique().tolist() == [0, 1]


def test_more_balls_leave_the_rest_of_an_episode_as_it_is() -> None:
    few, many = (Engine(config(f"task.balls={n}"), 8, 0).reset() for n in (2, 4))
    for name in ("human_pos", "joint_pos"):
        assert torch.equal(getattr(few, name), getattr(many, name))
    assert torch.equal(few.colours[:, 0], many.colours[:, 0])


def test_too_many_balls_for_the_table_or_the_task_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"task.balls=7 must be from 1 to 6"):
        config("task.balls=7")
    with pytest.raises(ConfigError, match=r"task.balls=2.*choose sort"):
        compose("train", ["task=cycle", "task.balls=2", "task.ball_slots_m=[[0.0,0.0],[0.0,0.07]]"])


def test_aiming_moves_the_goal_and_is_refused_while_a_ball_is_held() -> None:
    engine = Engine(config("human=none"), 3, 0)
    engine.reset()
    engine.episodes.aim(torch.tensor([1]), torch.tensor([2]))
    state = engine.episodes.state
    assert state.target.tolist() == [0, 2, 0]
    assert torch.equal(state.ball_pos[1], state.balls[1, 2])
    drops = torch.stack([state.orange_drop, state.pink_drop], dim=1)
    assert torch.equal(state.drop_pos[1], drops[1, state.colours[1, 2]])
    engine.episodes.state = state.with_(stage=torch.tensor([0, 1, 0]))
    with pytest.raises(ValueError, match="cannot be picked"):
        engine.episodes.aim(torch.tensor([1]), torch.tensor([0]))


@pytest.mark.parametrize("choose", [nearest, cautious])
def test_experts_sort_every_ball_once(choose) -> None:
    engine = Engine(config("task.balls=3", "human=none"), 2, 0)
    options = sorting_options(META, EXPERTS, engine.scene, engine.episodes.config, 0)
    engine.reset()
    steps = list(execute(engine, OptionExecutor(options, 500, engine.episodes), choose))
    assert steps[-1].result.state.placed.all() and steps[-1].result.success.all()
    for row in range(2):
        runs = [run for step in steps for run in step.runs if run.row == row]
        assert sorted(run.option for run in runs if run.option.startswith("pick")) == [
            "pick_1",
            "pick_2",
            "pick_3",
        ]
        assert [run.option for run in runs][1::3] == ["place"] * 3
        assert all(run.termination == "success" for run in runs)


def decision(engine: Engine, executor: OptionExecutor, **changes) -> Decision:
    return replace(executor.decision(engine.episodes.state), waits=torch.zeros(8, dtype=torch.int64), **changes)


@pytest.fixture(scope="module")
def begun() -> tuple[Engine, OptionExecutor]:
    engine = Engine(config(), 8, 0)
    engine.reset()
    options = sorting_options(META, STILL, engine.scene, engine.episodes.config, 0)
    return engine, OptionExecutor(options, 500, engine.episodes)


def test_only_options_that_can_start_are_offered(begun) -> None:
    engine, executor = begun
    mask = executor.available(engine.episodes.state)
    assert mask[:, :4].all() and mask[:, WAIT].all()
    assert not (mask[:, 4] | mask[:, 5] | mask[:, RETREAT]).any()  # place and return follow the picks
    state = engine.episodes.state
    placed = state.placed.clone()
    placed[:, 1] = True
    assert not executor.available(state.with_(placed=placed))[:, 1].any()


def test_what_was_preempted_goes_home_before_anything_else() -> None:
    engine = Engine(config("human=none"), 8, 0)
    state = engine.reset()
    options = sorting_options(META, STILL, engine.scene, engine.episodes.config, 0)
    executor, everyone = OptionExecutor(options, 5, engine.episodes), torch.ones(8, dtype=torch.bool)
    near, away = (state.joint_home + math.radians(degrees) for degrees in (9, 11))
    assert executor.available(state.with_(joint_pos=away))[:, :4].all()
    executor.begin(everyone, torch.zeros(8, dtype=torch.int64))
    outcome = engine.step(torch.zeros(8, 6).numpy())
    assert (executor.ended(outcome).termination == TERMINATIONS.index(Termination.PREEMPTED)).all()
    for stage in (0, 1, 2):
        lost = state.with_(joint_pos=away, stage=torch.full((8,), stage))
        mask = executor.available(lost)
        assert mask[:, RETREAT].all() and (mask.sum(dim=1) == 1).all()
        for choose in (nearest, cautious):
            asked = replace(decision(engine, executor), state=lost, mask=mask)
            assert (choose(asked) == len(options) + RETREAT).all()
    assert executor.available(state.with_(joint_pos=near))[:, :4].all()
    executor.begin(everyone, torch.zeros(8, dtype=torch.int64))
    taken = outcome.state.with_(stage=torch.ones(8, dtype=torch.int64), joint_pos=away)
    executor.ended(replace(outcome, state=taken))
    assert executor.available(taken)[:, 4].all()  # what succeeds leaves the arm where the next skill begins


def test_the_arm_rests_where_it_is_slow_and_retreats_with_no_ball(begun) -> None:
    engine, executor = begun
    away = engine.episodes.state.joint_home + math.radians(11)
    for stage, rests, retreats in ((0, True, False), (1, True, False), (2, False, True), (3, True, False)):
        there = engine.episodes.state.with_(joint_pos=away, stage=torch.full((8,), stage))
        mask = executor.available(there)
        assert (mask[:, WAIT] == rests).all() and (mask[:, RETREAT] == retreats).all()


def test_a_pause_lasts_as_long_as_it_says_whatever_the_limit_and_ends_where_its_ball_is_lost() -> None:
    engine = Engine(config("human=none"), 3, 0)
    holding = torch.ones(3, dtype=torch.int64)
    engine.episodes.state = engine.reset().with_(stage=holding)
    options = sorting_options(META, STILL, engine.scene, engine.episodes.config, 0)
    executor, everyone = OptionExecutor(options, 5, engine.episodes), torch.ones(3, dtype=torch.bool)
    executor.begin(everyone, torch.full((3,), len(options) + WAIT))
    outcome = engine.step(torch.zeros(3, 6).numpy())
    for steps, stage, termination in (
        (20, 1, None),
        (25, 1, Termination.SUCCESS),
        (25, 0, Termination.PREEMPTED),
    ):
        there = outcome.state.with_(steps=torch.full((3,), steps), stage=stage * holding)
        ended = executor.ended(replace(outcome, state=there))
        assert (ended.rows == (termination is not None)).all()
        assert termination is None or (ended.termination == TERMINATIONS.index(termination)).all()


def test_after_a_preempted_option_the_environment_above_options_offers_nothing_but_the_way_home() -> None:
    def make(engine: Engine) -> list:
        return sorting_options(META, EXPERTS, engine.scene, engine.episodes.config, 0)

    env = OptionEnv(config("human=none"), make, 10, 2, 0, 0.99)
    td, count = env.reset(), len(env.executor.options)
    stuck = env.step(td.set("action", torch.tensor([0, count + WAIT])))["next"]
    preempted = TERMINATIONS.index(Termination.PREEMPTED)
    assert stuck["deciding"].all(dim=-1).tolist() == [True, False] and int(stuck["termination"][0]) == preempted
    home = torch.arange(count) == count + RETREAT
    assert torch.equal(stuck["action_mask"][0], home)
    anew = env.reset(TensorDict({"_reset": torch.tensor([[True], [False]])}, batch_size=[2]))
    assert anew["action_mask"][0, :4].all()


def test_a_skill_may_be_told_another_level_than_the_one_in_force(begun) -> None:
    engine, _ = begun
    env = config("comfort=sort")
    options = sorting_options(replace(META, level_override=[1, 6]), STILL, engine.scene, env, 0)
    names = [option.name for option in options]
    assert names[:6] == ["pick_1", "pick_2", "pick_3", "pick_4", "place", "return"]
    assert names[6:12] == [f"{name}_as_1" for name in names[:6]] and names[-2:] == ["wait", "retreat"]
    asked = decision(engine, OptionExecutor(options, 500, engine.episodes))
    assert (asked.mask[:, :4] == asked.mask[:, 6:10]).all()
    wait = len(names) + WAIT
    assert (nearest(asked) < 4).all() and all(k < 4 or k == wait for k in cautious(asked).tolist())


def test_a_skill_acts_as_at_the_level_it_is_told(begun, monkeypatch) -> None:
    monkeypatch.setattr(sorting_module, "make_policy", lambda *_: lambda state: state.level[:, None])
    env = config("comfort=sort")
    options = sorting_options(replace(META, level_override=[6]), STILL, begun[0].scene, env, 0)
    state = begun[0].episodes.state.with_(level=torch.full((8,), 3.0, dtype=torch.float64))
    heard = {}
    for index, option in enumerate(options[:12]):
        chosen = torch.full((8,), index)
        heard[option.name] = act(options, chosen, state, chosen >= 0)[0, 0].item()
    assert all(level == (6 if name.endswith("_as_6") else 3) for name, level in heard.items())


@pytest.mark.parametrize("overrides", [["comfort=sort", "comfort.levels=5"], []])
def test_a_level_that_is_not_there_is_not_told(begun, overrides) -> None:
    env = config(*overrides)
    with pytest.raises(ConfigError, match=r"meta_controller\.level_override=6 with comfort\.source"):
        sorting_options(replace(META, level_override=[6]), STILL, begun[0].scene, env, 0)


def test_whoever_waits_comes_to_rest_where_they_are(begun) -> None:
    engine = Engine(config("human=none"), 2, 0)
    state = engine.reset()
    for _ in range(3):
        state = engine.step(np.full((2, 6), 0.4)).state
    began = state.joint_pos
    for _ in range(6):
        state = engine.step(stop(engine.episodes.config.task)(state).numpy()).state
    rest = state.joint_pos
    state = engine.step(stop(engine.episodes.config.task)(state).numpy()).state
    assert (rest - began).abs().max() < 0.015  # it runs on by 0.021 rad where the targets stay ahead
    assert (state.joint_pos - rest).abs().max() < 1e-3 and state.joint_vel.abs().max() < 0.02


def test_a_random_controller_chooses_what_can_start(begun) -> None:
    choose, asked = at_random(3), decision(*begun)
    for _ in range(20):
        assert asked.mask.gather(1, choose(asked)[:, None]).all()


def test_nearest_takes_the_nearest_ball(begun) -> None:
    asked = decision(*begun)
    away = (asked.state.balls - asked.state.tcp_pos[:, None]).norm(dim=-1)
    assert torch.equal(nearest(asked), away.argmin(dim=1))


def test_cautious_waits_for_a_person_at_the_goal_but_not_for_ever(begun) -> None:
    asked = decision(*begun)
    here = asked.state.with_(human_pos=asked.state.balls[:, 0, :2])
    wait = asked.mask.shape[1] + WAIT
    assert (cautious(replace(asked, state=here)) == wait).all()
    assert (cautious(replace(asked, state=here, waits=torch.full((8,), 6))) != wait).all()


@pytest.mark.parametrize("near", [False, True])
@pytest.mark.parametrize("name", ["scripted", "cautious"])
def test_a_controller_that_learns_nothing_gives_every_skill_the_first_level_it_may(name: str, near: bool) -> None:
    engine = Engine(config("comfort=sort"), 8, 0)
    engine.reset()
    found = []
    for levels in ([], [6, 2]):
        words = [
            "task=sort", "comfort=sort", f"meta_controller={name}", f"meta_controller.level_override={levels}",
            *(f"policies.{skill}=random" for skill in STILL),
        ]  # fmt: skip
        executor, choose = make_executor(compose("evaluate", words), None, engine, 0)
        asked = decision(engine, executor)
        if near:
            asked = replace(asked, state=asked.state.with_(human_pos=asked.state.balls[:, 0, :2]))
        found.append([executor.options[each].name for each in choose(asked).tolist()])
    plain, told = found
    assert told == [each if each in ("wait", "retreat") else f"{each}_as_6" for each in plain]
    assert ("wait" in plain) == (name == "cautious")
    assert not near or name == "scripted" or set(plain) == {"wait"}


def test_the_learned_controllers_observation_is_finite_with_and_without_a_level(begun) -> None:
    state = begun[0].episodes.state
    for level, layout in product((float("nan"), 3.0), PERSON):
        seen = meta_observation(state.with_(level=torch.full((8,), level, dtype=torch.float64)), 10, layout)
        assert seen.shape == (8, observation_dim(layout, 4)) and bool(seen.isfinite().all())
    assert (observation_dim("default", 4), observation_dim("proximity", 4)) == (18 + 9 * 4, 15 + 9 * 4)


def test_proximity_is_nearness_to_the_tool_in_the_place_of_position_and_facing() -> None:
    engine = Engine(config("human=patrol"), 8, 0)
    state = engine.reset()
    mirrored = 2 * state.tcp_pos[:, :2] - state.human_seen
    there = state.with_(human_seen=mirrored, human_yaw=state.human_yaw + 1.0)
    first_ball = observation_dim("proximity", 0)
    seen, other = (meta_observation(each, 10, "proximity")[:, :first_ball] for each in (state, there))
    torch.testing.assert_close(seen, other)
    assert not torch.allclose(meta_observation(state, 10)[:, :4], meta_observation(there, 10)[:, :4])


TRACKER = ("randomise.person_noise_m=[0.02,0.02]", "randomise.person_rate_hz=[10,10]")


@pytest.mark.parametrize(
    ("overrides", "shown"),
    [((), True), (TRACKER, True), (("human.masked=true",), False), (("human.clipping=full", *TRACKER), False)],
)
def test_the_learned_controller_sees_where_people_face_unless_they_are_clipped_or_masked(
    overrides: tuple[str, ...], shown: bool
) -> None:
    engine = Engine(config("human=patrol", *overrides), 8, 0)
    engine.reset()
    state = engine.step(np.zeros((8, 6))).state
    facing = torch.stack([state.human_yaw.cos(), state.human_yaw.sin()], dim=-1).float() * shown
    assert torch.equal(meta_observation(state, 10)[:, 2:4], facing)


@pytest.mark.parametrize("layout", PERSON)
def test_a_trained_controller_is_saved_and_sorts(tmp_path, layout: str) -> None:
    folder = tmp_path / "meta_controller"
    overrides = [
        "task.balls=2", "human=none", "engine.num_envs=4",
        "meta_controller_agent.options=24", "meta_controller_agent.warmup_options=8",
        "meta_controller_agent.batch_size=8", "meta_controller_agent.log_every=12", f"output={folder}",
        f"meta_controller_agent.observation={layout}",
        *(f"policies.{name}=expert" for name in EXPERTS),
    ]  # fmt: skip
    trained = compose("train_meta_controller", overrides)
    assert isinstance(trained, MetaControllerTrainConfig)
    train_meta_controller(trained)
    rows = (folder / "meta_controller_metrics.csv").read_text().splitlines()
    assert rows[0].startswith("options,updates,episodes") and len(rows) >= 3
    with pytest.raises(ConfigError, match="already holds a controller"):
        train_meta_controller(trained)
    assert [found.name for found in find_runs(tmp_path)] == ["meta_controller"]  # a report of its parent still works
    with pytest.raises(ConfigError, match=r"among \['pick_1'.*here there are \['wait'\] at 10"):
        load_choice(str(folder), 10, ["wait"])
    old = checkpoint.load(folder / "meta_controller.pt")
    names = old["spec"]["names"]
    checkpoint.save(tmp_path / "old.pt", {**old, "spec": {**old["spec"], "observation_dim": 38}})
    here = observation_dim(layout, 2)
    with pytest.raises(
        ConfigError, match=rf"^policies.meta_controller=\S+ was trained on 38 observations; here there are {here}"
    ):
        load_choice(str(tmp_path / "old.pt"), 10, names)
    checkpoint.save(tmp_path / "layout.pt", {**old, "spec": {**old["spec"], "observation": "x"}})
    with pytest.raises(ConfigError, match="is damaged: its observation is 'x', not default or proximity"):
        load_choice(str(tmp_path / "layout.pt"), 10, names)
    broken = {name: torch.full_like(value, torch.nan) for name, value in old["network"].items()}
    checkpoint.save(tmp_path / "nan.pt", {**old, "network": broken})
    with pytest.raises(ConfigError, match="is damaged: its weights are not all finite numbers"):
        load_choice(str(tmp_path / "nan.pt"), 10, names)
    checkpoint.save(tmp_path / "odd.pt", {**old, "spec": [1]})
    with pytest.raises(ConfigError, match="is not a trained controller"):
        load_choice(str(tmp_path / "odd.pt"), 10, names)
    result = rollout(
        compose(
            "evaluate",
            [
                "task=sort", "task.balls=2", "human=none", "meta_controller=learned", "episodes=2",
                "task.max_episode_steps=400",
                "comfort=sort", f"policies.meta_controller={folder}", *(f"policies.{name}=expert" for name in EXPERTS),
            ],
        )
    )  # fmt: skip
    assert len(result.episodes) == 2 and np.isfinite([e.return_ for e in result.episodes]).all()


def test_a_controller_is_taught_beside_the_people_of_its_skills_in_a_task_of_its_own(tmp_path) -> None:
    save_config(compose("train", ["task=pick", "human=arc", "reward=dense"]), tmp_path / "config.yaml")
    taught = compose("train_meta_controller", [f"policies.pick='{tmp_path}'"])
    assert isinstance(taught, MetaControllerTrainConfig)
    plain = compose("train_meta_controller")
    assert taught.human.motion == "arc"
    assert (taught.task, taught.reward, taught.comfort) == (plain.task, plain.reward, plain.comfort)


def test_a_wait_ends_with_the_episode_that_succeeds_meanwhile(begun) -> None:
    engine, executor = begun
    state = engine.episodes.state
    executor.begin(torch.ones(8, dtype=torch.bool), torch.full((8,), len(executor.options) + WAIT))
    outcome = engine.step(torch.zeros(8, 6).numpy())
    won = replace(outcome, success=torch.ones(8, dtype=torch.bool), terminated=torch.ones(8, dtype=torch.bool))
    ended = executor.ended(won)
    assert ended.rows.all() and (ended.termination == TERMINATIONS.index(Termination.SUCCESS)).all()
    engine.episodes.state = state


def test_balls_that_could_overlap_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"ball_jitter_m=0.03 lets balls come within"):
        Engine(config("task.ball_jitter_m=0.03"), 2, 0)


def test_a_controller_learns_to_take_the_option_that_pays() -> None:
    """Two options, one pays 1 and one 0, at once and for good; a third that would pay 9 cannot start."""
    agent = compose(
        "train_meta_controller",
        ["meta_controller_agent.batch_size=32", "meta_controller_agent.learning_rate=0.01"],
    ).meta_controller_agent
    learner = QLearner(agent, 2, 3, 0)
    mask = torch.tensor([[True, True, False]]).expand(64, 3)
    action = torch.arange(64) % 2
    after = {
        "observation": torch.ones(64, 2), "action_mask": mask, "reward": (action == 0).float()[:, None],
        "done": torch.ones(64, 1, dtype=torch.bool), "terminated": torch.ones(64, 1, dtype=torch.bool),
        "truncated": torch.zeros(64, 1, dtype=torch.bool),
    }  # fmt: skip
    now = {"observation": torch.ones(64, 2), "action_mask": mask, "action": action}
    steps = {"steps_to_next_obs": torch.full((64, 1), 20)}
    learner.remember(TensorDict({**now, **steps, "next": TensorDict(after, batch_size=[64])}, batch_size=[64]))
    for _ in range(200):
        learner.update()
    values = learner.network(TensorDict({"observation": torch.ones(1, 2), "action_mask": mask[:1]}, [1]))
    assert values["action_value"][0, :2].tolist() == pytest.approx([1.0, 0.0], abs=0.05)
    assert learner.choose(torch.ones(1, 2), mask[:1], 0.0).tolist() == [0]


def test_what_is_kept_of_a_controller_is_the_mean_of_its_networks(tmp_path) -> None:
    agent = compose(
        "train_meta_controller", ["meta_controller_agent.batch_size=4", "meta_controller_agent.ema_rate=0.25"]
    ).meta_controller_agent
    learner = QLearner(agent, 1, 2, 0)
    no, mask = torch.zeros(8, 1, dtype=torch.bool), torch.ones(8, 2, dtype=torch.bool)
    after = {
        "observation": torch.ones(8, 1), "action_mask": mask, "reward": torch.ones(8, 1), "done": ~no,
        "terminated": ~no, "truncated": no,
    }  # fmt: skip
    now = {"observation": torch.ones(8, 1), "action_mask": mask, "action": torch.arange(8) % 2}
    steps = {"steps_to_next_obs": torch.full((8, 1), 10)}
    learner.remember(TensorDict({**now, **steps, "next": TensorDict(after, batch_size=[8])}, batch_size=[8]))
    weights = []
    for _ in range(3):
        learner.update()
        weights.append({name: value.clone() for name, value in learner.network.state_dict().items()})
    learner.save(tmp_path / "meta_controller.pt", {})
    kept = checkpoint.load(tmp_path / "meta_controller.pt")["network"]
    for name, value in kept.items():
        first, second, third = (weight[name] for weight in weights)
        torch.testing.assert_close(value, 0.75 * (0.75 * first + 0.25 * second) + 0.25 * third)


def test_what_an_option_leads_to_is_discounted_by_its_length() -> None:
    """One state, one option of 10 control steps that pays 1: V = 1 / (1 - gamma**10)."""
    changes = ["batch_size=32", "learning_rate=0.01", "gamma=0.95", "tau=0.1", "hidden=[16]"]
    agent = compose(
        "train_meta_controller", [f"meta_controller_agent.{change}" for change in changes]
    ).meta_controller_agent
    learner = QLearner(agent, 1, 2, 0)
    one, mask = torch.ones(32, 1), torch.tensor([[True, False]]).expand(32, 2)
    no = torch.zeros(32, 1, dtype=torch.bool)
    after = {
        "observation": one, "action_mask": mask, "reward": one, "done": no, "terminated": no, "truncated": no,
    }  # fmt: skip
    now = {"observation": one, "action_mask": mask, "action": torch.zeros(32, dtype=torch.int64)}
    steps = {"steps_to_next_obs": torch.full((32, 1), 10)}
    learner.remember(TensorDict({**now, **steps, "next": TensorDict(after, batch_size=[32])}, batch_size=[32]))
    for _ in range(600):
        learner.update()
    values = learner.network(TensorDict({"observation": one[:1], "action_mask": mask[:1]}, [1]))
    assert values["action_value"][0, 0].item() == pytest.approx(1 / (1 - 0.95**10), rel=0.05)


def test_a_controller_that_does_not_sort_is_refused() -> None:
    with pytest.raises(ConfigError, match="train meta_controller takes task=sort"):
        compose("train_meta_controller", ["task=cycle"])
    with pytest.raises(ConfigError, match="is for task=sort"):
        rollout(
            compose(
                "evaluate",
                [
                    "task=cycle",
                    "meta_controller=cautious",
                    "episodes=1",
                    *(f"policies.{n}=expert" for n in EXPERTS),
                ],
            )
        )


def test_a_task_says_how_long_its_options_may_take_unless_the_controller_does() -> None:
    def limit(*overrides: str) -> int:
        config = compose("evaluate", ["meta_controller=scripted", *overrides])
        assert isinstance(config, EvaluateConfig)
        return config.meta_controller.time_limit_steps

    assert limit("task=sort") == 100 and limit("task=cycle") == 500
    assert limit("task=sort", "meta_controller.time_limit_steps=7") == 7
