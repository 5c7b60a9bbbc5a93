"""Comfort of the human: levels, reward terms and metrics."""
