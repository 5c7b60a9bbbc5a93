"""Comfort of the person beside the robot: measured always."""
