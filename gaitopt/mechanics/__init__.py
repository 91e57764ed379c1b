"""The mechanics that both independent methods share: walkers, contact, impact, saltation and control laws."""

from gaitopt.mechanics.control.bezier_tracking import BezierTracking as BezierTracking
from gaitopt.mechanics.control.law import ConstantTorque as ConstantTorque
from gaitopt.mechanics.control.law import Control as Control
from gaitopt.mechanics.control.law import NoControl as NoControl
from gaitopt.mechanics.control.law import ProportionalDerivative as ProportionalDerivative
from gaitopt.mechanics.control.reference import BeyondEnd as BeyondEnd
from gaitopt.mechanics.control.reference import Piece as Piece
from gaitopt.mechanics.control.reference import Reference as Reference
from gaitopt.mechanics.cycle import Cycle as Cycle
from gaitopt.mechanics.cycle import ModeSequence as ModeSequence
from gaitopt.mechanics.dynamics import Dynamics as Dynamics
from gaitopt.mechanics.friction import CoulombFriction as CoulombFriction
from gaitopt.mechanics.friction import StaticKineticFriction as StaticKineticFriction
from gaitopt.mechanics.margins import MARGINS as MARGINS
from gaitopt.mechanics.margins import ONSETS as ONSETS
from gaitopt.mechanics.margins import ending_margin as ending_margin
from gaitopt.mechanics.margins import margin as margin
from gaitopt.mechanics.margins import margin_names as margin_names
from gaitopt.mechanics.margins import margin_scales as margin_scales
from gaitopt.mechanics.margins import margin_unit as margin_unit
from gaitopt.mechanics.modes import CONTACTS as CONTACTS
from gaitopt.mechanics.modes import ImpactLaw as ImpactLaw
from gaitopt.mechanics.modes import Mode as Mode
from gaitopt.mechanics.scales import Scales as Scales
from gaitopt.mechanics.system import HybridSystem as HybridSystem
from gaitopt.mechanics.walker import Walker as Walker
