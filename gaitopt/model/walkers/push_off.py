"""Compass biped that pushes off: an impulse along the stance leg just before the swing foot lands. Kuo (2002).

The push acts between ground and foot in the direction of the leg and needs friction tan(theta1). With less friction
the motion ends with ``push_slips``. Otherwise the walker is the compass.
"""

from dataclasses import replace
from types import SimpleNamespace
from typing import Annotated

from pydantic import Field

from gaitopt.model.mechanism import Link, Mechanism, polar
from gaitopt.model.units import NonNegative, Within
from gaitopt.model.walkers.compass_biped import CompassBiped


class PushOffCompass(CompassBiped):
    """Compass biped that pushes off with its stance leg."""

    model = "push_off_compass"
    pushes = True

    push: Annotated[
        NonNegative,
        Field(description="impulse of the push along the stance leg [N s]"),
        Within(unit="impulse", possible=(0, 100), usual=(0, 1)),
    ]

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """The compass, with its push."""
        return replace(super().mechanism(q, p), push=polar(p.push, q.theta1))

    @classmethod
    def links(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Link, ...]:
        """The links of the compass."""
        return super().links(q, p)
