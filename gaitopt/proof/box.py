"""Boxes of unknowns along a curve of orbits.

    u = centre(s) + w,      w in a box about zero,      s in [-1, 1]

u are the unknowns of an orbit; in a family they depend on a parameter lower + (upper - lower) (1 + s) / 2.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flint import arb, arb_mat

from gaitopt.proof.parametric import at, hull


def identity(n: int) -> arb_mat:
    """The unit matrix."""
    return arb_mat(n, n, [int(i == j) for i in range(n) for j in range(n)])


@dataclass(frozen=True, slots=True)
class Box:
    """A box of unknowns; see the module.

    Attributes
    ----------
    centre : exact, or polynomials with exact coefficients; shape (n,).
    deviation : w, balls about zero; shape (n,).
    """

    centre: Sequence[Any]
    deviation: Sequence[arb]

    @property
    def whole(self) -> list[Any]:
        """All u."""
        return [value + w for value, w in zip(self.centre, self.deviation, strict=True)]

    @property
    def hull(self) -> list[arb]:
        """All u for all values of the parameter."""
        return list(map(hull, self.whole))

    def end(self, side: int) -> list[arb]:
        """All u at the upper (1) or at the lower end (-1) of the parameter's interval."""
        return [at(value, arb(side)) for value in self.whole]

    @property
    def column(self) -> arb_mat:
        """w as a matrix."""
        return arb_mat(len(self.deviation), 1, [w.union(arb(0)) for w in self.deviation])
