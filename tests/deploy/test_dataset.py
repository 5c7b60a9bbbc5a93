"""Data sets are read by Minari, tell what the episodes did, and teach an offline learner."""

import json

import minari
import numpy as np
import pytest
import torch

import hrl_comfort
from docs.behaviour_cloning import clone
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import VALIDATION_SEED, ConfigError
from hrl_comfort.deploy.dataset import dataset
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.hierarchy.controllers import make_executor

CONDITIONED = "comfort=conditioned"
EXPERTS = [f"policies.{name}=expert" for name in ("pick", "place", "return")]


def written(output, *overrides):
    return dataset(compose("evaluate", [*overrides, "split=validation", f"output={output}"]))


@pytest.fixture(scope="module")
def pick(tmp_path_factory):
    output = tmp_path_factory.mktemp("dataset") / "data"
    folder = written(output, "policy=runs/reference/pick", "episodes=600", CONDITIONED)
    assert folder == output / "hrl_comfort" / "pick-v0"
    return output


def test_minari_loads_the_data_set_by_its_name(pick, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(pick))
    loaded = minari.load_dataset("hrl_comfort/pick-v0")
    assert loaded.total_episodes == 600
    assert loaded.storage.metadata["dataset_size"] == loaded.storage.get_size() > 1  # MB
    assert json.loads(loaded.storage.metadata["environment"])["task"]["name"] == "pick"
    episode = next(loaded.iterate_episodes())
    assert episode.observations.shape == (len(episode) + 1, *loaded.observation_space.shape)
    assert loaded.action_space.contains(episode.actions[0])
    assert set(episode.infos) == {
        "comfort_level",
        "stage",
        "option",
        "contact",
        "unsafe_contact",
        "success",
        "control_steps",
    }


def test_every_episode_ends_once_and_says_how(pick):
    for episode in minari.MinariDataset(pick / "hrl_comfort" / "pick-v0" / "data").iterate_episodes():
        ends = episode.terminations | episode.truncations
        assert ends[-1] and not ends[:-1].any()
        assert len(episode.infos["success"]) == len(episode) + 1
        assert episode.infos["option"][0] == -1 and (episode.infos["option"][1:] == 0).all()
        assert 1 <= episode.infos["comfort_level"][-1] <= 10


def test_behaviour_cloning_from_the_data_set_picks(pick, monkeypatch):
    """At least 80 % on episodes that the data do not hold."""
    file = pick / "clone.pt"
    torch.save(clone(pick / "hrl_comfort" / "pick-v0").state_dict(), file)
    monkeypatch.setenv("CLONE", str(file))
    later = {"split": "validation", "episode_seed": VALIDATION_SEED + 600, "comfort": "conditioned"}
    assert hrl_comfort.evaluate("docs.behaviour_cloning:policy", "pick", 100, **later)["success"].mean() >= 0.8


def test_a_chain_tells_its_options(tmp_path):
    folder = written(tmp_path / "data", "task=cycle", "meta_controller=nearest", "episodes=3", *EXPERTS)
    loaded = minari.MinariDataset(folder / "data")
    assert loaded.storage.metadata["options"] == ["pick", "place", "return"]
    assert set(next(loaded.iterate_episodes()).infos["option"][1:]) == {0, 1, 2}


@pytest.mark.parametrize("top", ["nearest", "oracle"])
def test_an_action_is_stored_beside_what_it_was_chosen_on(top, tmp_path, monkeypatch):
    """Even where an option aims at another object before it acts, and where cells wait for one another (`oracle`)."""
    chosen = [], []

    def made(config, policy, engine, seed):
        executor, top = make_executor(config, policy, engine, seed)
        act, episodes = executor.act, engine.episodes

        def noted(state, acting):
            observation, action = episodes.subtask.observe(episodes.observed(state)), act(state, acting)
            for row in torch.nonzero(acting).squeeze(-1).tolist():
                chosen[row].append((observation[row], action[row]))
            return action

        executor.act = noted
        return executor, top

    monkeypatch.setattr("hrl_comfort.deploy.dataset.make_executor", made)
    sort = ["task=sort", "task.objects=2", f"meta_controller={top}"]
    folder = written(tmp_path / "data", *sort, "episodes=2", *EXPERTS)
    for episode, expected in zip(minari.MinariDataset(folder / "data").iterate_episodes(), chosen, strict=True):
        observations, actions = (torch.stack(each).float().numpy() for each in zip(*expected, strict=True))
        np.testing.assert_array_equal(episode.observations[:-1], observations)
        np.testing.assert_array_equal(episode.actions, actions)


def test_a_random_policy_does_in_a_data_set_what_it_does_in_an_evaluation(tmp_path, monkeypatch):
    """However many episodes are simulated side by side."""
    monkeypatch.setattr("hrl_comfort.deploy.dataset.BATCH", 2)
    words = ["policy=random", "task=reach", "episodes=4"]
    episodes = [*minari.MinariDataset(written(tmp_path / "data", *words) / "data").iterate_episodes()]
    evaluated = rollout(compose("evaluate", [*words, "split=validation"])).episodes
    assert [sum(each.infos["control_steps"]) for each in episodes] == [each.steps for each in evaluated]
    returns = [each.return_ for each in evaluated]
    np.testing.assert_allclose([each.rewards.sum() for each in episodes], returns, rtol=1e-5)


def test_a_folder_with_files_is_refused(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(ConfigError, match="holds other files"):
        written(tmp_path, "policy=expert", "episodes=1")
    assert [each.name for each in tmp_path.iterdir()] == ["mine.txt"]
