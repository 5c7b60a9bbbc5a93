"""Environments of options: Gymnasium's check, rows alike, evaluations alike, masks, durations and refusals."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

from hrl_comfort import options_of
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.files.run_config import save_config
from hrl_comfort.gym import OPTION_IDS
from hrl_comfort.hierarchy.tops import nearest
from tests.envs.pictures import drawn

SHORT: dict[str, Any] = {"task.max_episode_steps": 250}
QUICK: dict[str, Any] = {**SHORT, "human": "none"}
SORT = OPTION_IDS["sort"]


def made(task: str = "sort", **choices: Any) -> Any:
    return gymnasium.make(OPTION_IDS[task], **{**QUICK, **choices}).unwrapped


def first_able(mask: np.ndarray) -> np.ndarray:
    return mask.argmax(axis=-1)


@pytest.mark.parametrize("task", list(OPTION_IDS))
@pytest.mark.filterwarnings("ignore:.*Box observation space")
def test_every_task_of_options_passes_gymnasiums_own_check(task: str) -> None:
    env = gymnasium.make(OPTION_IDS[task], **SHORT)
    assert OPTION_IDS[task] == f"hrl_comfort/{task.title()}-Options-v0"
    check_env(env.unwrapped, skip_render_check=True)
    assert len(env.unwrapped.names) == env.action_space.n
    env.close()


@pytest.mark.parametrize("task", ["sort", "kitting"])
def test_the_rows_of_a_batch_are_single_environments(task: str) -> None:
    choices = {**SHORT, "gamma": 0.99}
    cells = gymnasium.make_vec(OPTION_IDS[task], num_envs=3, **choices)
    lone = [gymnasium.make(OPTION_IDS[task], **choices) for _ in range(3)]
    observations, infos = cells.reset(options={"episode": 4, "split": "validation"})
    begun = [env.reset(options={"episode": 4 + row, "split": "validation"}) for row, env in enumerate(lone)]
    assert all((observations[row] == each[0]).all() for row, each in enumerate(begun))
    ended, durations, rng = np.zeros(3, bool), set(), np.random.default_rng(0)
    while not ended.all():
        actions = np.array([rng.choice(np.flatnonzero(mask)) for mask in infos["action_mask"]])
        observations, rewards, terminated, truncated, infos = cells.step(actions)
        durations |= {tuple(infos["duration"])}
        for row in np.flatnonzero(~ended):
            seen, reward, over, late, info = lone[row].step(int(actions[row]))
            assert (reward, over, late) == (rewards[row], terminated[row], truncated[row])
            ended[row] = over or late
            last = infos["final_obs"][row] if ended[row] else observations[row]
            values = infos["final_info"] if ended[row] else infos
            assert (seen == last).all() and info["duration"] == infos["duration"][row]
            assert all(np.array_equal(info[name], values[name][row], equal_nan=True) for name in info)
    assert any(len(set(each)) > 1 for each in durations), "rows waited for one another"


def test_returns_are_those_of_an_evaluation_with_the_same_top() -> None:
    choices = {"task.max_episode_steps": 500, "split": "validation"}
    config = options_of("kitting", {**choices, "episodes": 3})
    table = rollout(config).table
    cells = gymnasium.make_vec(OPTION_IDS["kitting"], num_envs=3, **choices)
    _, infos = cells.reset(options={"episode": 0, "split": "validation"})
    returns, steps, ended = np.zeros(3), np.zeros(3, int), np.zeros(3, bool)
    while not ended.all():
        _, rewards, terminated, truncated, infos = cells.step(nearest(cells.unwrapped.decision()).numpy())
        returns += np.where(ended, 0.0, rewards)
        steps += np.where(ended, 0, infos["duration"])
        ended |= terminated | truncated
    assert np.round(returns, 6).tolist() == table["return"].tolist()
    assert steps.tolist() == table["steps"].tolist()


def test_rewards_of_an_option_are_discounted_by_the_control_step() -> None:
    plain, discounted = made(reward="sort"), made(reward="sort", gamma=0.99)
    rewards = []
    for env in (plain, discounted):
        env.reset(seed=3)
        _, reward, *_, info = env.step(0)
        rewards.append(reward)
    steps = info["duration"]  # with nobody there, only time is paid for
    assert rewards == pytest.approx([-0.001 * steps, -0.001 * (1 - 0.99**steps) / (1 - 0.99)])


def test_an_option_that_cannot_start_never_does() -> None:
    env, rng = made(), np.random.default_rng(0)
    _, info = env.reset(seed=0)
    replaced = 0
    for _ in range(12):
        mask, action = info["action_mask"], int(rng.integers(env.action_space.n))
        assert (mask == env.action_masks()).all() and mask.any()
        *_, terminated, truncated, info = env.step(action)
        assert mask[info["option"]] and info["option"] == (action if mask[action] else first_able(mask))
        replaced += info["option"] != action
        if terminated or truncated:
            _, info = env.reset()
    assert replaced


@pytest.mark.parametrize("action", [-1, 8, 0.5, "pick_1", None, [0], np.zeros(2, int)])
def test_other_actions_are_refused(action: object) -> None:
    env = made()
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"must be \(\) whole numbers from 0 to 7, each an option"):
        env.step(action)


def test_other_choices_are_refused() -> None:
    with pytest.raises(TypeError, match="the options of sort got an unexpected keyword argument 'frameskip'"):
        made(frameskip=1)
    with pytest.raises(ConfigError, match=r"gamma=1\.5"):
        made(gamma=1.5)
    with pytest.raises(ConfigError, match="observation='all' is not allowed; choose one of default, jobs"):
        made(observation="all")
    with pytest.raises(ConfigError, match=r"policies='expert' must be a mapping"):
        made(policies="expert")
    with pytest.raises(ConfigError, match="neither the folder of a hierarchy"):
        made(run="runs/nowhere")
    with pytest.raises(ConfigError, match="task='pick' is not allowed"):
        options_of("pick")
    with pytest.raises(ConfigError, match="num_envs=0"):
        gymnasium.make_vec(SORT, num_envs=0)
    with pytest.raises(ConfigError, match="shows one cell"):
        gymnasium.make_vec(SORT, num_envs=2, render_mode="human")


def test_skills_are_those_of_a_hierarchy_in_the_world_of_their_training() -> None:
    run = "runs/reference/shielded/seed2"
    config = options_of("sort", {"human": "none", **SHORT}, run)
    assert config.policies == {name: f"{run}/{name}" for name in ("pick", "place", "return")}
    assert config.safety.kind == "ssm" and config.human.motion == "none" and config.reward.step == -0.001
    other = options_of("sort", {"policies": {"pick": "direct"}})
    assert other.policies == {"pick": "direct", "place": "expert", "return": "expert"}
    assert made(run=run).names[0] == "pick_1"


def test_the_world_and_skills_of_a_controllers_training_are_taken(tmp_path: Any) -> None:
    skills = [f"policies.{name}=direct" for name in ("pick", "place", "return")]
    words = ["human=worker", "meta_controller.level_override=[2]", "task.objects=2", *skills]
    trained = compose("train_meta_controller", [*words, f"output={tmp_path}"])
    save_config(trained, tmp_path / "config.yaml")
    config = options_of("sort", {"task.max_episode_steps": 100}, tmp_path)
    assert config.human.motion == "worker" and config.task.objects == 2 and config.task.max_episode_steps == 100
    assert config.policies["pick"] == "direct" and config.meta_controller.level_override == [2]
    with pytest.raises(ConfigError, match=r"was trained for task=sort, not shift"):
        options_of("shift", {}, tmp_path)


@pytest.mark.parametrize("key", ["levels", "regret", "checkpoints"])
def test_what_only_an_evaluation_reads_is_refused(key: str) -> None:
    value = {"levels": [1], "regret": True, "checkpoints": "all"}[key]
    with pytest.raises(ConfigError, match=rf"^{key}=.* is for hrl-comfort evaluate; leave it out$"):
        made(**{key: value})


def test_a_copy_goes_on_where_it_is() -> None:
    env = made("kitting", human="fetcher", **{"task.max_episode_steps": 3000})
    env.reset(seed=0)
    env.step(0)
    for twin in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        assert (twin.action_masks() == env.action_masks()).all() and twin.names == env.names
        again = copy.deepcopy(twin)
        action = int(first_able(twin.action_masks()))
        first, second = twin.step(action), again.step(action)
        assert (first[0] == second[0]).all() and first[1] == second[1]


def test_a_seed_begins_the_same_episodes_and_tops_see_a_decision() -> None:
    env, other = made(), made()
    for each in (env, other):
        each.reset(seed=5)
    assert torch.equal(env.decision().state.objects, other.decision().state.objects)
    assert env.decision().table.names == env.names and int(nearest(env.decision())) in range(len(env.names))


def test_pictures_show_the_ends_of_options() -> None:
    env = made(render_mode="rgb_array")
    env.reset(seed=0)
    env.step(0)
    assert drawn(env.render).shape == (360, 480, 3)
