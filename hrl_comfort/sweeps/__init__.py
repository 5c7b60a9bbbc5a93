"""Sweeps (`-m`): the launcher and its jobs."""
