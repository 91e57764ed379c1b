"""A box of motions, carried along an arc as the motion from its middle and the derivative of all others.

y(x) in centre + slope (x - x_centre),      slope encloses dy/dx on the box        (mean value form)
"""

from collections.abc import Sequence
from dataclasses import dataclass

from flint import arb, arb_mat

from gaitopt.proof.field import Field
from gaitopt.proof.graph import NotProved
from gaitopt.proof.taylor import Expansion, Step, expand, follow


@dataclass(slots=True)
class Bundle:
    """The motions from every x of a box, at one time:  y in centre + slope (x - x_centre).

    Attributes
    ----------
    deviation : x - x_centre, balls about zero.
    centre : the motion from the centre of the box, in tiny balls; shape (n,).
    slope : D, shape (n, n_x).
    """

    deviation: list[arb]
    centre: list[arb]
    slope: arb_mat

    @property
    def hull(self) -> list[arb]:
        """A box around all motions."""
        spread = self.slope * arb_mat(len(self.deviation), 1, self.deviation)
        return [y + spread[i, 0] for i, y in enumerate(self.centre)]

    def fix(self, k: int, value: arb) -> None:
        """State ``k`` is known to have a value."""
        self.centre[k] = value
        for j in range(len(self.deviation)):
            self.slope[k, j] = arb(0)


def carry(field: Field, bundle: Bundle, steps: Sequence[Step], middle: arb, duration: arb) -> list[Expansion]:
    """The steps of one arc, the last of which ends with the arc: after ``middle`` for the centre of the bundle.

    The bundle is moved along; its slope does not know yet that the duration varies.
    """
    if not steps or steps[-1].h is not None or any(step.h is None for step in steps[:-1]):
        raise NotProved("the steps of an arc do not add up to it: the last one, and it alone, ends with the arc")
    before = sum((arb(step.h) for step in steps[:-1]), arb(0))
    expansions: list[Expansion] = []
    for step in steps:
        h, h_middle = (duration - before, middle - before) if step.h is None else (arb(step.h), arb(step.h))
        expansions.append(expand(field, bundle.hull, step, h))
        variation = expansions[-1].shooting_jacobian()
        bundle.centre = follow(expansions[-1], bundle.centre, h_middle, variation)
        bundle.slope = variation * bundle.slope
    return expansions


def identity(n: int) -> arb_mat:
    """The unit matrix."""
    return arb_mat(n, n, [int(i == j) for i in range(n) for j in range(n)])
