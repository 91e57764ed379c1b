"""Names, labels and units of what is printed."""

import math

QUANTITIES = {
    "friction": ("friction coefficient", ""),
    "period": ("period", "s"),
    "step_length": ("step length", "m"),
    "speed": ("speed", "m/s"),
    "work": ("motor work", "J"),
    "cost_of_transport": ("cost of transport", ""),
    "absolute_cost_of_transport": ("absolute cost of transport", ""),
    "torque_squared": ("torque squared, integral", "N^2 m^2 s"),
    "peak_torque": ("peak torque", "N m"),
    "slip_distance": ("slip distance", "m"),
    "foot_clearance": ("foot clearance", "m"),
    "required_friction": ("required friction in stick", ""),
    "impulse_ratio": ("impulse ratio for a sticking impact", ""),
    "min_normal_force": ("smallest normal force", "N"),
    "spectral_radius": ("largest multiplier, modulus", ""),
}
"""Label and unit of every scalar of a result by its key in the JSON."""

NEGLIGIBLE = 1e-12
"""Shown as zero: rounding, in any unit that occurs here."""

CONTROL_UNITS = {"kp": "N m/rad", "kd": "N m s/rad"}
"""Units of a control's scalars; any other is a torque."""


def state_unit(name: str) -> str:
    """Unit of a state: x is a distance, everything else an angle."""
    length = name in {"x", "dx"}
    return ("m" if length else "rad") + ("/s" if name.startswith("d") else "")


def number(value: float | None) -> str:
    """Six digits for the eye; the JSON has them all."""
    if value is None:
        return "-"
    return f"{0.0 if abs(value) < NEGLIGIBLE else value:.6g}"


def with_degrees(value: float, unit: str) -> str:
    """The unit, and for an angle the value in degrees behind it."""
    return f"{unit} ({math.degrees(value):.5g} deg)" if unit == "rad" else unit
