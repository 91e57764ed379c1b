"""The mechanics that both independent methods share: walkers, contact, impact, saltation and control laws."""

from gaitopt.mechanics.consistency import check_walker
from gaitopt.mechanics.control import (
    BeyondEnd,
    BezierTracking,
    ConstantTorque,
    Control,
    NoControl,
    Piece,
    ProportionalDerivative,
    Reference,
    control_points,
)
from gaitopt.mechanics.cycle import Cycle, ModeSequence
from gaitopt.mechanics.dynamics import Dynamics
from gaitopt.mechanics.friction import CoulombFriction, Friction, StaticKineticFriction
from gaitopt.mechanics.margins import (
    IMPACT_MARGINS,
    MARGINS,
    ONSETS,
    PHASE_MARGINS,
    ending_margin,
    margin,
    margin_names,
    margin_scales,
    margin_unit,
)
from gaitopt.mechanics.mechanism import Body, Damper, Mechanism
from gaitopt.mechanics.modes import CONTACTS, ImpactLaw, Mode
from gaitopt.mechanics.registry import find_walker, refused_walkers, registered_walkers
from gaitopt.mechanics.scales import Scales
from gaitopt.mechanics.system import HybridSystem
from gaitopt.mechanics.walker import Walker
from gaitopt.mechanics.walkers.compass_biped import CompassBiped
from gaitopt.mechanics.walkers.rimless_wheel import RimlessWheel

__all__ = [
    "CONTACTS",
    "IMPACT_MARGINS",
    "MARGINS",
    "ONSETS",
    "PHASE_MARGINS",
    "BeyondEnd",
    "BezierTracking",
    "Body",
    "CompassBiped",
    "ConstantTorque",
    "Control",
    "CoulombFriction",
    "Cycle",
    "Damper",
    "Dynamics",
    "Friction",
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
    "StaticKineticFriction",
    "Walker",
    "check_walker",
    "control_points",
    "ending_margin",
    "find_walker",
    "margin",
    "margin_names",
    "margin_scales",
    "margin_unit",
    "refused_walkers",
    "registered_walkers",
]
