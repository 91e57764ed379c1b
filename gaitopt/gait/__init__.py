"""Gaits and trajectories as data, and the scalars that describe them."""

from gaitopt.gait.measures import Observation, measure, observe
from gaitopt.gait.trajectory import Arc, Ending, ImpactRecord, Step, Trajectory

__all__ = ["Arc", "Ending", "ImpactRecord", "Observation", "Step", "Trajectory", "measure", "observe"]
