"""Fronts of the same episodes: dm_control for one cell, TorchRL for many, Gymnasium for either."""
