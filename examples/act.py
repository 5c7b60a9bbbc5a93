"""Load a trained policy with its environment, and act: `python examples/act.py [RUN]`, from any folder."""

import sys
from pathlib import Path

import hrl_comfort

ROOT = Path(__file__).resolve().parents[1]
run = sys.argv[1] if len(sys.argv) > 1 else ROOT / "runs/reference/shielded/seed2/pick"

env = hrl_comfort.load(run=run, seed=0, flat_observation=True)  # dm_control, with the robot, people and shield of RUN
policy = hrl_comfort.load_policy(run)  # observations (D,) to actions (A,)
step = env.reset()
decisions = 0
while not step.last():
    step = env.step(policy(step.observation["observations"]))
    decisions += 1
print(f"{decisions} decisions of 100 ms; the reward of the last one is {step.reward:.1f}")
