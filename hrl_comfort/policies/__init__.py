"""Policies: maps from observations to actions, and how `policy=` is resolved."""
