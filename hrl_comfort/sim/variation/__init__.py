"""Differences of cells from the model and from each other, and disturbances."""
