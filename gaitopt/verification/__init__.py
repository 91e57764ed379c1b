"""Comparison of a gait with the simulation; return map and multipliers; simulated walks."""
