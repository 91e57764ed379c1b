"""The mechanics that both roads to a gait share: walkers, contact, impact, saltation and control laws."""

from gaitopt.mechanics.bezier_tracking import BezierTracking, control_points
from gaitopt.mechanics.compass_biped import CompassBiped
from gaitopt.mechanics.control import ConstantTorque, Control, NoControl, ProportionalDerivative
from gaitopt.mechanics.modes import ImpactLaw, Mode, ModeSequence
from gaitopt.mechanics.reference import BeyondEnd, Piece, Reference
from gaitopt.mechanics.rimless_wheel import RimlessWheel
from gaitopt.mechanics.scales import Scales
from gaitopt.mechanics.system import HybridSystem, ending_margin, margin_names, margin_scales
from gaitopt.mechanics.walker import Body, Mechanism, Walker, find_walker, refused_walkers, registered_walkers

__all__ = [
    "BeyondEnd",
    "BezierTracking",
    "Body",
    "CompassBiped",
    "ConstantTorque",
    "Control",
    "HybridSystem",
    "ImpactLaw",
    "Mechanism",
    "Mode",
    "ModeSequence",
    "NoControl",
    "Piece",
    "ProportionalDerivative",
    "Reference",
    "RimlessWheel",
    "Scales",
    "Walker",
    "control_points",
    "ending_margin",
    "find_walker",
    "margin_names",
    "margin_scales",
    "refused_walkers",
    "registered_walkers",
]
