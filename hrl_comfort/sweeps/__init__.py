"""Multirun: the launcher and its jobs."""
