"""Numbers as they are printed."""

import math

NEGLIGIBLE = 1e-12
"""Shown as zero: rounding, in any unit that occurs here."""


def number(value: float | None) -> str:
    """Six digits for the eye; the JSON has them all."""
    if value is None:
        return "-"
    return f"{0.0 if abs(value) < NEGLIGIBLE else value:.6g}"


def with_degrees(value: float, unit: str) -> str:
    """The unit, and for an angle the value in degrees behind it."""
    return f"{unit} ({math.degrees(value):.5g} deg)" if unit == "rad" else unit
