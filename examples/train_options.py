"""Train learners to choose jobs in `kitting`: `python examples/train_options.py [OPTIONS] [SHIFTS]`; needs `sb3`."""

import sys

import gymnasium
import numpy as np
from sb3_contrib import QRDQN, MaskablePPO
from stable_baselines3 import PPO

from hrl_comfort.sb3 import make_vec_env
from hrl_comfort.sb3_buffers import OptionMaskableRolloutBuffer, OptionReplayBuffer, OptionRolloutBuffer

ID, GAMMA = "hrl_comfort.gym:hrl_comfort/Kitting-Options-v0", 0.998  # of a control step: k of them have GAMMA ** k
options = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
shifts = int(sys.argv[2]) if len(sys.argv) > 2 else 24


def mean_return(model):
    """Return the mean return of shifts in which `model` chooses the options."""
    cells = gymnasium.make_vec(ID, num_envs=shifts).unwrapped
    observations, _ = cells.reset(options={"episode": 0, "split": "validation"})
    returns, going_on = np.zeros(shifts), np.ones(shifts, dtype=bool)
    while going_on.any():
        masks = {"action_masks": cells.action_masks()} if isinstance(model, MaskablePPO) else {}
        chosen, _ = model.predict(observations, deterministic=True, **masks)
        observations, rewards, terminated, truncated, _ = cells.step(chosen)
        returns += np.where(going_on, rewards, 0.0)
        going_on &= ~(terminated | truncated)
    return returns.mean()


env = make_vec_env(ID, 16, seed=0, gamma=GAMMA)
given = {"gamma": GAMMA, "n_steps": 16, "device": "cpu"}
replay = {"replay_buffer_class": OptionReplayBuffer, "replay_buffer_kwargs": {"gamma": GAMMA}}
ppo = PPO("MlpPolicy", env, rollout_buffer_class=OptionRolloutBuffer, **given)
masked = MaskablePPO("MlpPolicy", env, rollout_buffer_class=OptionMaskableRolloutBuffer, **given)
qrdqn = QRDQN("MlpPolicy", env, learning_starts=1000, gradient_steps=8, device="cpu", **replay)
for model in (ppo, masked, qrdqn):
    print(f"{type(model).__name__} after {options} options: {mean_return(model.learn(options)):.2f}")
