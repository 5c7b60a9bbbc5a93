"""Connections to real hands."""
