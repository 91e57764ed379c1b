"""Control laws: joint torques as functions of time since impact, angles and rates."""

from gaitopt.mechanics.control.bezier_tracking import BezierTracking, control_points
from gaitopt.mechanics.control.law import ConstantTorque, Control, NoControl, ProportionalDerivative
from gaitopt.mechanics.control.reference import BeyondEnd, Piece, Reference

__all__ = [
    "BeyondEnd",
    "BezierTracking",
    "ConstantTorque",
    "Control",
    "NoControl",
    "Piece",
    "ProportionalDerivative",
    "Reference",
    "control_points",
]
