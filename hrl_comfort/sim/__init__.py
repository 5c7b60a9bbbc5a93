"""Simulation: the batched engine, its episodes, and inverse kinematics."""
