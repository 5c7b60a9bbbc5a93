"""Train SAC of Stable-Baselines3 on pick, in 16 cells: `python examples/train_sb3.py [STEPS] [FILE]`.

Needs the extra `sb3`. With 200,000 steps the policy takes the object at nearly every try.
"""

import sys

from stable_baselines3 import SAC

import hrl_comfort
from hrl_comfort.sb3 import make_vec_env

steps = int(sys.argv[1]) if len(sys.argv) > 1 else 200_000
file = sys.argv[2] if len(sys.argv) > 2 else "runs/sb3_pick.zip"

env = make_vec_env("hrl_comfort/Pick-v0", 16, seed=0, human="random_walk")
model = SAC("MlpPolicy", env, gamma=0.95, learning_starts=1000, gradient_steps=4, device="cpu", seed=0)
model.learn(steps)
model.save(file)

episodes = hrl_comfort.evaluate(f"sb3:{file}", task="pick", episodes=100, split="validation", human="random_walk")
print(f"success {100 * episodes['success'].mean():.1f} % of {len(episodes)} episodes")
