"""Train PPO, MaskablePPO and QRDQN to choose jobs in `kitting`: `python examples/train_options.py [OPTIONS] [SHIFTS]`.

An action is an option: pick an object, place it, go home, wait. Needs the extra `sb3`.
"""

import sys

import gymnasium
import numpy as np
from sb3_contrib import MaskablePPO, QRDQN
from stable_baselines3 import PPO

from hrl_comfort.hierarchy.tops import due
from hrl_comfort.sb3 import make_vec_env
from hrl_comfort.sb3_buffers import OptionMaskableRolloutBuffer, OptionReplayBuffer, OptionRolloutBuffer

ID = "hrl_comfort.gym:hrl_comfort/Kitting-Options-v0"
GAMMA = 0.998  # a control step of 20 ms: an option of k of them has GAMMA ** k
options = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
shifts = int(sys.argv[2]) if len(sys.argv) > 2 else 24


def mean_return(choose):
    """Return the mean return of shifts in which `choose(cells, observations)` gives the options (N,)."""
    cells = gymnasium.make_vec(ID, num_envs=shifts)
    observations, _ = cells.reset(options={"episode": 0, "split": "validation"})
    returns, going_on = np.zeros(shifts), np.ones(shifts, dtype=bool)
    while going_on.any():
        observations, rewards, terminated, truncated, _ = cells.step(choose(cells, observations))
        returns += np.where(going_on, rewards, 0.0)
        going_on &= ~(terminated | truncated)
    return returns.mean()


env = make_vec_env(ID, 16, seed=0, gamma=GAMMA)
rollouts = {"gamma": GAMMA, "n_steps": 16, "device": "cpu", "seed": 0}
replay = {"replay_buffer_class": OptionReplayBuffer, "replay_buffer_kwargs": {"gamma": GAMMA}}
learners = {
    "PPO": PPO("MlpPolicy", env, rollout_buffer_class=OptionRolloutBuffer, **rollouts),
    "MaskablePPO": MaskablePPO("MlpPolicy", env, rollout_buffer_class=OptionMaskableRolloutBuffer, **rollouts),
    "QRDQN": QRDQN("MlpPolicy", env, learning_starts=1000, gradient_steps=8, device="cpu", seed=0, **replay),
}
print(f"the rule `due`: {mean_return(lambda cells, _: due(cells.unwrapped.decision()).numpy()):.2f}")
for name, model in learners.items():
    model.learn(options)
    known = {"MaskablePPO": lambda cells: {"action_masks": cells.unwrapped.action_masks()}}.get(name, lambda _: {})
    found = mean_return(lambda cells, seen: model.predict(seen, deterministic=True, **known(cells))[0])
    print(f"{name} after {options} options: {found:.2f}")
