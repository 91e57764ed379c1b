"""Gaits and trajectories as data, and the scalars that describe them."""

from gaitopt.gait.branch import TERMINAL, Branch, BranchPoint, SpecialPoint, branch_header, branch_rows
from gaitopt.gait.cause import Cause, in_words
from gaitopt.gait.gait import Gait, Shooting, Status
from gaitopt.gait.measures import MEASURES, Observation, measure, measure_scales, observe
from gaitopt.gait.multipliers import floquet_multipliers, multiplier_distance
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
    "Observation",
    "Shooting",
    "SpecialPoint",
    "Status",
    "Step",
    "Trajectory",
    "branch_header",
    "branch_rows",
    "floquet_multipliers",
    "in_words",
    "measure",
    "measure_scales",
    "multiplier_distance",
    "observe",
]
