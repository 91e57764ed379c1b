"""A box of motions, carried along an arc as the motion from its middle and the derivative of all others.

y(v) in centre + slope v,      slope encloses dy/dv on the box        (mean value form)
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flint import arb, arb_mat

from gaitopt.proof.field import Field
from gaitopt.proof.graph import NotProved
from gaitopt.proof.parametric import scattered
from gaitopt.proof.taylor import Expansion, expand, follow


@dataclass(slots=True)
class Bundle:
    """The motions from every point of a box, at one time:  y in centre + slope v.

    Attributes
    ----------
    deviation : v, balls that contain zero; shape (n_v,).
    centre : the motion with v = 0, in tiny balls; shape (n,).
    slope : shape (n, n_v).
    """

    deviation: arb_mat
    centre: list[Any]
    slope: Any

    @property
    def box(self) -> list[Any]:
        """A box around all motions."""
        spreads = scattered(self.slope * self.deviation, arb_mat.entries)
        return [y + spread for y, spread in zip(self.centre, spreads, strict=True)]

    def fix(self, k: int, value: arb) -> None:
        """State ``k`` is known to have a value."""
        self.centre[k] = value
        n = len(self.centre)
        self.slope = arb_mat(n, n, [int(i == j != k) for i in range(n) for j in range(n)]) * self.slope


def carry(field: Field, bundle: Bundle, steps: Sequence[float], middle: Any, duration: Any) -> list[Expansion]:
    """One arc in steps of given lengths and a last one that ends with the arc: after ``middle`` for the centre.

    The bundle is moved along; its slope does not know yet that the duration varies.
    """
    if not all(h > 0 for h in steps):
        raise NotProved("a step of the integration is not longer than zero")
    before = sum(map(arb, steps), arb(0))
    lengths = [(arb(h), arb(h)) for h in steps] + [(duration - before, middle - before)]
    expansions: list[Expansion] = []
    for h, h_middle in lengths:
        expansions.append(expand(field, bundle.box, h))
        variation = expansions[-1].shooting_jacobian()
        bundle.centre = follow(field, expansions[-1], bundle.centre, h_middle, variation)
        bundle.slope = variation * bundle.slope
    return expansions
