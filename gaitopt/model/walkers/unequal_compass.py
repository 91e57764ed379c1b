"""Compass biped whose legs differ: it limps, and its gaits repeat after two steps.

``theta1`` is the angle of the stance leg and ``theta2`` that of the swing leg, measured as those of the compass. In the
first step of a cycle ``leg_mass`` and ``leg_com`` belong to the stance leg; they swap places with those of the other
leg at every touchdown.
"""

from dataclasses import replace
from types import SimpleNamespace
from typing import Annotated

from pydantic import Field

from gaitopt.model.mechanism import Link
from gaitopt.model.units import Positive, shorter
from gaitopt.model.walkers.compass_biped import CompassBiped


class UnequalCompass(CompassBiped):
    """Compass biped with a point mass at the hip and one on each leg; those of the legs may differ."""

    model = "unequal_compass"
    exchanged = {"leg_mass": "other_leg_mass", "leg_com": "other_leg_com"}  # noqa: RUF012 - a class variable of Walker

    other_leg_mass: Annotated[Positive, Field(description="point mass on the leg that swings in the first step [kg]")]
    other_leg_com: Annotated[Positive, Field(description="distance of that mass from the other leg's foot [m]")]

    _other_com_within_leg = shorter("other_leg_com", "leg_length")

    @classmethod
    def links(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Link, ...]:
        """The compass, with another mass on the leg that swings."""
        *stance, swing, hip = super().links(q, p)
        return *stance, replace(swing, mass=p.other_leg_mass, com=(0, p.other_leg_com - p.leg_length)), hip
