"""Boxes of unknowns, tilted along a branch of orbits so that they may be long without being wide.

    u = centre + frame v,      v in a box about zero

u are the unknowns of an orbit and, in a family, the parameter that varies. The frame is the unit matrix but for the
column of the coordinate u_k along which the box follows the branch: that is du / du_k, the tangent. The k-th entry of v
is then u_k - centre_k, and the others are what the tangent does not predict.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from flint import arb, arb_mat


def identity(n: int) -> arb_mat:
    """The unit matrix."""
    return arb_mat(n, n, [int(i == j) for i in range(n) for j in range(n)])


def vector(values: Sequence[arb]) -> arb_mat:
    """A vector as a matrix of one column."""
    return arb_mat(len(values), 1, list(values))


@dataclass(frozen=True, slots=True)
class Box:
    """A box of unknowns; see the module.

    Attributes
    ----------
    centre : exact, shape (n,).
    deviation : v, shape (n,).
    along : k, None where nothing varies.
    tangent : du / du_k, exact, with a one as its k-th entry; nothing where nothing varies.
    """

    centre: list[arb]
    deviation: list[arb]
    along: int | None = None
    tangent: Sequence[arb] = ()

    @property
    def frame(self) -> arb_mat:
        """du / dv, shape (n, n)."""
        return self._sheared(1)

    @property
    def inverse(self) -> arb_mat:
        """dv / du."""
        return self._sheared(-1)

    @property
    def hull(self) -> list[arb]:
        """A box around all u."""
        spread = (self.frame * vector(self.deviation)).entries()
        return [value + d for value, d in zip(self.centre, spread, strict=True)]

    @property
    def unknown(self) -> list[int]:
        """The columns of v that are solved for."""
        return [k for k in range(len(self.centre)) if k != self.along]

    def narrowed(self, unknown: Sequence[arb]) -> "Box":
        """The same box with other deviations of what is solved for."""
        deviation = list(self.deviation)
        for k, value in zip(self.unknown, unknown, strict=True):
            deviation[k] = value
        return replace(self, deviation=deviation)

    def end(self, side: int) -> "Box":
        """The last (1) or the first (-1) point of the box along the branch, with all deviations there."""
        if self.along is None:
            return self
        deviation = list(self.deviation)
        d = deviation[self.along]
        deviation[self.along] = d.upper() if side > 0 else d.lower()
        return replace(self, deviation=deviation)

    def contains(self, other: "Box") -> bool:
        """Whether every u of another box lies in this one."""
        apart = vector([a - b for a, b in zip(other.centre, self.centre, strict=True)])
        v = self.inverse * apart + (self.inverse * other.frame) * vector(other.deviation)
        return all(outer.contains(inner) for outer, inner in zip(self.deviation, v.entries(), strict=True))

    def _sheared(self, sign: int) -> arb_mat:
        matrix = identity(len(self.centre))
        if self.along is not None:
            for i in self.unknown:
                matrix[i, self.along] = sign * self.tangent[i]
        return matrix
