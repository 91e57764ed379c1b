"""Natural units (``mechanics.scales``) of the unknowns and equations of a transcription, and what its margins say."""

from dataclasses import dataclass

from gaitopt.arrays import Array
from gaitopt.mechanics import Scales, margin_unit


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
        return margin_unit(self.name, scales)


@dataclass(frozen=True, slots=True, kw_only=True)
class Units:
    """Natural units (``mechanics.scales``) in which unknowns and equations are of order one.

    Attributes
    ----------
    unknowns : ndarray, shape (n_w,) - of nodes and durations; freed parameters have one.
    equalities : ndarray - of the rows of ``Transcription.equalities``.
    """

    unknowns: Array
    equalities: Array
