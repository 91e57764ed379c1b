"""Numbers with units as users write them: angles in ``deg`` or ``rad``, everything else SI.

The table is closed: a general units library would parse (and evaluate) arbitrary expressions.
"""

import math
import re
from typing import Annotated

from pydantic import BeforeValidator, Field

from gaitopt.mechanics.ranges import Within, symmetric

ANGLE_UNITS = {"rad": 1.0, "deg": math.pi / 180}
_ANGLE = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(deg|rad)\s*")


def parse_angle(value: object) -> object:
    """``"1 deg"`` or ``"0.1 rad"`` in radians; anything else is passed on unchanged.

    Raises
    ------
    ValueError
        If a text is not a number followed by ``deg`` or ``rad``.
    """
    if not isinstance(value, str):
        return value
    match = _ANGLE.fullmatch(value)
    if match is None:
        raise ValueError("write an angle as a number in rad, or with its unit: 1 deg, 0.1 rad")
    return float(match[1]) * ANGLE_UNITS[match[2]]


SMALLEST, LARGEST = 1e-30, 1e30
"""Masses, lengths and forces stay so far from zero and infinity that their products exist in any units."""
STEEPEST = math.radians(80)
"""Steady walking needs friction tan(slope) [rad]: nearly 6 here."""

Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]
"""A number whose range depends on the walker."""
Number = Annotated[Finite, Field(ge=-LARGEST, le=LARGEST)]
"""A finite number."""
Positive = Annotated[Number, Field(ge=SMALLEST)]
"""A finite number above zero."""
NonNegative = Annotated[Number, Field(ge=0)]
"""A finite number, zero allowed."""
Angle = Annotated[Number, BeforeValidator(parse_angle)]
"""A finite angle [rad]; texts such as ``1 deg`` are converted."""
Stiffness = Annotated[NonNegative, Within(unit="stiffness", possible=(0, 1e6), usual=(0, 1e4))]
"""Of a spring along a line [N/m]."""
TurningStiffness = Annotated[NonNegative, Within(unit="torque", possible=(0, 1e6), usual=(0, 1e3))]
"""Of a spring that turns a joint [N m/rad]."""
Damping = Annotated[NonNegative, Within(unit="drag", possible=(0, 1e4), usual=(0, 100))]
"""Coefficient of a damper along a line [N s/m]."""
TurningDamping = Annotated[NonNegative, Within(unit="damping", possible=(0, 1e4), usual=(0, 100))]
"""Coefficient of a damper in a joint [N m s/rad]."""
Inertia = Annotated[NonNegative, Within(unit="inertia", possible=(0, 100), usual=(0, 1))]
"""About the centre of mass [kg m^2]."""
Slope = Annotated[Angle, Field(ge=-STEEPEST, le=STEEPEST), Within(usual=symmetric(math.radians(30)))]
"""An inclination of the ground [rad]."""
