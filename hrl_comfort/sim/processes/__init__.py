"""Cells shared out over processes: an engine of the whole in the parent, and one of its own rows in each child."""
