"""Two fronts of the same episodes: dm_control for one cell, TorchRL for many."""
