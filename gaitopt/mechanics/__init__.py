"""The mechanics that both independent methods share: walkers, contact, impact, saltation and control laws."""

from gaitopt.mechanics.control.bezier_tracking import BezierTracking
from gaitopt.mechanics.control.law import ConstantTorque, Control, NoControl, ProportionalDerivative
from gaitopt.mechanics.control.reference import BeyondEnd, Piece, Reference
from gaitopt.mechanics.cycle import Cycle, ModeSequence
from gaitopt.mechanics.dynamics import Dynamics
from gaitopt.mechanics.friction import CoulombFriction, StaticKineticFriction
from gaitopt.mechanics.margins import MARGINS, ONSETS, ending_margin, margin, margin_names, margin_scales, margin_unit
from gaitopt.mechanics.modes import CONTACTS, ImpactLaw, Mode
from gaitopt.mechanics.scales import Scales
from gaitopt.mechanics.system import HybridSystem
from gaitopt.mechanics.walker import Walker

__all__ = [
    "CONTACTS",
    "MARGINS",
    "ONSETS",
    "BeyondEnd",
    "BezierTracking",
    "ConstantTorque",
    "Control",
    "CoulombFriction",
    "Cycle",
    "Dynamics",
    "HybridSystem",
    "ImpactLaw",
    "Mode",
    "ModeSequence",
    "NoControl",
    "Piece",
    "ProportionalDerivative",
    "Reference",
    "Scales",
    "StaticKineticFriction",
    "Walker",
    "ending_margin",
    "margin",
    "margin_names",
    "margin_scales",
    "margin_unit",
]
