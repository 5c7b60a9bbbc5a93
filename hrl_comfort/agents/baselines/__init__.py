"""Baselines of hierarchical learning, one file each, all on soft actor-critic."""
