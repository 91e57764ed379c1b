"""Gaits and trajectories as data, and the scalars that describe them."""

from gaitopt.gait.branch import TERMINAL as TERMINAL
from gaitopt.gait.branch import Branch as Branch
from gaitopt.gait.branch import BranchPoint as BranchPoint
from gaitopt.gait.branch import SpecialPoint as SpecialPoint
from gaitopt.gait.branch import WalkState as WalkState
from gaitopt.gait.cause import Cause as Cause
from gaitopt.gait.cause import in_words as in_words
from gaitopt.gait.gait import Gait as Gait
from gaitopt.gait.gait import Status as Status
from gaitopt.gait.measures import MEASURES as MEASURES
from gaitopt.gait.measures import measure as measure
from gaitopt.gait.measures import observe as observe
from gaitopt.gait.multipliers import floquet_multipliers as floquet_multipliers
from gaitopt.gait.trajectory import Arc as Arc
from gaitopt.gait.trajectory import Ending as Ending
from gaitopt.gait.trajectory import ImpactRecord as ImpactRecord
from gaitopt.gait.trajectory import Step as Step
from gaitopt.gait.trajectory import Trajectory as Trajectory
