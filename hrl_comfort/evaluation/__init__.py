"""Evaluation: rollouts of policies and chains on a fixed set of episodes."""
