"""Gaits and trajectories as data, and the scalars that describe them."""

from gaitopt.gait.branch import TERMINAL, Branch, BranchPoint, SpecialPoint
from gaitopt.gait.cause import Cause, in_words
from gaitopt.gait.gait import Gait, Status
from gaitopt.gait.measures import MEASURES, measure, observe
from gaitopt.gait.multipliers import floquet_multipliers
from gaitopt.gait.trajectory import Arc, Ending, ImpactRecord, Step, Trajectory

__all__ = [
    "MEASURES",
    "TERMINAL",
    "Arc",
    "Branch",
    "BranchPoint",
    "Cause",
    "Ending",
    "Gait",
    "ImpactRecord",
    "SpecialPoint",
    "Status",
    "Step",
    "Trajectory",
    "floquet_multipliers",
    "in_words",
    "measure",
    "observe",
]
