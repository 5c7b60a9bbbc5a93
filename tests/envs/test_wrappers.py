"""Gymnasium's own wrappers and vector environments take the fronts."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode
from gymnasium.wrappers import AddRenderObservation, RecordEpisodeStatistics, RecordVideo
from gymnasium.wrappers.vector import RecordEpisodeStatistics as RecordVectorStatistics

from hrl_comfort.scene.camera import PicturesUnavailableError
from tests.envs import cleanrl_sac
from tests.envs.pictures import drawn

ID = "hrl_comfort.gym:hrl_comfort/Pick-v0"
SHORT = {"task.max_episode_steps": 20}


def test_record_video_writes_an_episode(tmp_path: Path) -> None:
    env = RecordVideo(gymnasium.make(ID, render_mode="rgb_array", **SHORT), str(tmp_path), lambda episode: episode == 0)
    env = RecordEpisodeStatistics(env)
    drawn(lambda: env.reset(seed=0))
    ended = False
    while not ended:
        *_, terminated, truncated, info = env.step(np.zeros(6, np.float32))
        ended = terminated or truncated
    env.close()
    assert info["episode"]["l"] == 4
    (video,) = tmp_path.glob("*.mp4")
    assert video.read_bytes()[4:8] == b"ftyp"


def test_pictures_can_be_the_observation() -> None:
    env = AddRenderObservation(gymnasium.make(ID, render_mode="rgb_array"))
    observation, _ = drawn(env.reset)
    assert observation.shape == (360, 480, 3)
    env.close()


def test_other_processes_step_the_same_episodes() -> None:
    # TorchRL sets the start method to spawn, by which every process imports torch anew.
    chosen = {"autoreset_mode": AutoresetMode.SAME_STEP, "context": "fork"}
    apart = gymnasium.make_vec(ID, 2, "async", chosen, **SHORT)
    assert isinstance(apart, AsyncVectorEnv)
    alone = gymnasium.make(ID, **SHORT)
    observations, _ = apart.reset(seed=3)
    for row in (1, 0):
        assert (observations[row] == alone.reset(seed=3 + row)[0]).all()
    for _ in range(4):
        observations, rewards, _, truncated, _ = apart.step(np.zeros((2, 6), np.float32))
        _, reward, *_ = alone.step(np.zeros(6, np.float32))
        assert rewards[0] == reward
    assert truncated.all()
    apart.close()


def test_statistics_of_a_batch_are_recorded() -> None:
    cells = gymnasium.make_vec(ID, num_envs=3, **SHORT)
    assert cells.metadata["autoreset_mode"] == cells.unwrapped.autoreset_mode == AutoresetMode.SAME_STEP
    cells = RecordVectorStatistics(cells)
    cells.reset(seed=0)
    for _ in range(4):
        *_, info = cells.step(np.zeros((3, 6), np.float32))
    assert info["_episode"].all() and (info["episode"]["l"] == 4).all()
    cells.close()


def test_a_single_file_sac_in_the_style_of_cleanrl_trains(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["--env-id", ID, "--num-envs", "2", "--total-timesteps", "30", "--learning-starts", "10"]
    try:
        returns = cleanrl_sac.main([*words, "--capture-video", "--batch-size", "8"])
    except PicturesUnavailableError:
        returns = cleanrl_sac.main([*words, "--batch-size", "8"])
    else:
        assert list(tmp_path.rglob("*.mp4"))
    assert np.isfinite(returns).all()
