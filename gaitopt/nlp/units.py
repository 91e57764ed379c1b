"""Natural units (``mechanics.scales``) of the unknowns and equations of a transcription, and what its margins say."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitopt.mechanics import Scales, margin_unit

Array = NDArray[np.float64]

IMPACT_UNITS: Mapping[str, Callable[[Scales], float]] = {
    "impulse": lambda scales: scales.impulse,
    "impulse_cone_forward": lambda scales: scales.impulse,
    "impulse_cone_backward": lambda scales: scales.impulse,
    "lift_velocity": lambda scales: scales.speed,
    "impact_slip_velocity": lambda scales: scales.speed,
    "touchdown_rate": lambda scales: 1 / scales.time,
    "impact_painleve": lambda scales: scales.mass,
    "impact_onset": lambda scales: scales.impulse,
}
"""Natural units of the margins of an impact, by name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """What one row of the inequalities says: the margin's name, and the phase and node where it is taken.

    ``phase`` and ``node`` are None for an impact, ``step`` is the index of its step.
    """

    name: str
    phase: int | None = None
    node: int | None = None
    step: int = 0

    def unit(self, scales: Scales) -> float:
        """Natural unit of the row."""
        return IMPACT_UNITS[self.name](scales) if self.phase is None else margin_unit(self.name, scales)


@dataclass(frozen=True, slots=True, kw_only=True)
class Units:
    """Natural units (``mechanics.scales``) in which unknowns and equations are of order one, whatever SI makes of them.

    Attributes
    ----------
    unknowns : ndarray, shape (n_w,) - of nodes and durations; freed parameters have one.
    equalities : ndarray - of the rows of ``Transcription.equalities``.
    """

    unknowns: Array
    equalities: Array
