"""Environments with the same episodes: dm_control (one cell), TorchRL (N cells), Gymnasium (both)."""
