"""Evaluate baselines at four comfort levels, and draw a figure: `python examples/evaluate_and_plot.py [EPISODES]`."""

import sys

import matplotlib.pyplot as plt

import hrl_comfort

count = int(sys.argv[1]) if len(sys.argv) > 1 else 50
figure, axes = plt.subplots(1, 2, figsize=(8, 3), layout="constrained")
for policy in ("expert", "potential_field"):
    episodes = hrl_comfort.evaluate(
        policy,
        task="pick_place",
        episodes=count,
        levels=[1, 4, 7, 10],
        split="validation",
        comfort="conditioned",
        human="patrol",
    )
    level = episodes.groupby("comfort_level")
    axes[0].plot(level["human_distance_mean_m"].mean(), marker="o", label=policy)
    axes[1].plot(100 * level["success"].mean(), marker="o", label=policy)
axes[0].set(xlabel="comfort level", ylabel="distance to the person, m")
axes[1].set(xlabel="comfort level", ylabel="success, %", ylim=(0, 105))
axes[1].legend()
figure.savefig("levels.png", dpi=150)
print("levels.png")
