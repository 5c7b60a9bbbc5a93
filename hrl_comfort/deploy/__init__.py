"""Policies outside this package: files that other programs run."""
