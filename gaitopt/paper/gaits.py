"""The gaits and families of the paper, by short names, and the readings of the text that differ from ours.

The named problems of the catalogue are the gaits as we read the paper; everything else is one of them with a few values
changed.
"""

from collections.abc import Mapping
from functools import lru_cache
from itertools import product
from types import MappingProxyType
from typing import Any

from gaitopt.gait import Gait
from gaitopt.paper.archive import Archive, Records
from gaitopt.problem import Problem, load_problem

FRICTIONLESS: Mapping[str, Any] = MappingProxyType({"impact_law": "frictionless"})
PRINTED_TORQUES: Mapping[str, tuple[float, float]] = MappingProxyType({"I": (-2.73, 0.54), "II": (-0.69, 0.12)})
"""tau1 and tau2 as printed [N m]."""
HALF_DIGIT = 0.005
"""By which the printed torques may be off [N m]."""
CORNERS = tuple(product((-1, 1), repeat=2))


def torques_here(tau1: float, tau2: float) -> dict[str, float]:
    """Printed torques in the sign convention of gaitopt (see ``docs/conventions.md``)."""
    return {"control.ankle": -tau1 - 2 * tau2, "control.hip": tau2}


SOURCES: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "wheel": ("rimless-wheel-stick", {}),
    "wheel slipping": ("rimless-wheel-slip", {}),
    "passive": ("compass-passive-stick", {}),
    "passive, leg as printed": (
        "compass-passive-stick",
        {
            "walker.leg_length": 0.8,
            "walker.leg_com": 0.5,
            "friction": 1.0,
            "gait.guess.state.theta1": -0.15,
            "gait.guess.state.dtheta1": 0.996,
            "gait.guess.state.dtheta2": -0.43,
        },
    ),
    "A": ("compass-passive-a", {}),
    "B": ("compass-passive-b", {}),
    "B, frictionless impact": ("compass-passive-b", FRICTIONLESS),
    "I": ("compass-torque-stick", {}),
    "II": ("compass-torque-impact-slip", {}),
    "II, frictionless impact": ("compass-torque-impact-slip", FRICTIONLESS),
    "III": ("compass-pd-impact-slip", {}),
    **{
        f"III, {end}": ("compass-pd-impact-slip", {"control.reference.beyond_end": end})
        for end in ("linear", "hold", "off")
    },
}
"""Problem and changes of every gait that a figure or a number needs."""

FAMILIES: Mapping[str, tuple[float, ...]] = {
    "II, frictionless impact": (0.1, 0.3),
    "B, frictionless impact": (0.1, 0.35),
    "passive": (0.1,),
    "I": (0.09,),
    "II": (0.1, 0.3),
    "wheel": (0.1,),
    "B": (0.1, 0.35),
    "III": (0.05, 0.5),
}
"""Coefficients of friction towards which these gaits are continued; the longest families are the last."""
ROUNDED = ("I", "II, frictionless impact")
"""Gaits of torques that are printed rounded."""


@lru_cache
def problem_of(name: str) -> Problem:
    """The problem behind a short name."""
    source, changes = SOURCES[name]
    problem = load_problem(source)
    return problem.replace(changes) if changes else problem


def gait_of(archive: Archive, name: str) -> Gait:
    """The gait with a short name."""
    return archive.gait(problem_of(name))


def has_gait(archive: Archive, name: str) -> bool:
    """Whether that gait is kept already."""
    return archive.has_gait(problem_of(name))


def family_of(archive: Archive, name: str) -> Records:
    """The family over the coefficient of friction that starts at the gait with a short name."""
    return archive.family(problem_of(name), "friction", FAMILIES[name])


def has_family(archive: Archive, name: str) -> bool:
    """Whether that family is kept already."""
    return archive.has_family(problem_of(name), "friction", FAMILIES[name])


def rounded_torques(archive: Archive, name: str) -> list[Gait]:
    """Gait I or II for the four corners of the torques that round to the printed ones."""
    tau1, tau2 = PRINTED_TORQUES[name.partition(",")[0]]
    corners = [torques_here(tau1 + a * HALF_DIGIT, tau2 + b * HALF_DIGIT) for a, b in CORNERS]
    return [archive.gait(problem_of(name).replace(corner)) for corner in corners]
