"""What the parts of the reproduction show: gaits, and families over friction, by their short names."""

from collections.abc import Mapping, Sequence
from enum import StrEnum

from gaitopt.paper.archive import Archive
from gaitopt.paper.gaits import (
    FAMILIES,
    ROUNDED,
    SOURCES,
    family_of,
    gait_of,
    has_family,
    has_gait,
    problem_of,
    rounded_torques,
)

TABLE = "table"
"""The part that is not a figure."""
CONTROLLED = {
    "I": "I, constant torques",
    "II": "II, weak torques",
    "II, frictionless impact": "II, frictionless impact",
    "III": "III, PD law",
}
SHOWN: Mapping[str, Mapping[str, str]] = {
    "fig2": {"wheel": "no slip, μ = 1", "wheel slipping": "stick-slip, μ = 0.4"},
    "fig3": {"wheel": "no slip"},
    "fig4": {"wheel": "wheel"},
    "fig6": {"passive": "no slip"},
    "fig7": {"passive": "passive", "I": "gait I"},
    "fig8": {"A": "A", "B": "B"},
    "fig8-frictionless": {"A": "A", "B, frictionless impact": "B, frictionless impact"},
    "fig9": {
        "passive": "sticking impact (A)",
        "B": "slipping impact (B)",
        "B, frictionless impact": "B, frictionless impact",
    },
    "fig10": {"passive": "passive", "I": "gait I"},
    "fig11": CONTROLLED,
    "fig12": CONTROLLED,
}
"""Gaits in each figure, and what they are called there."""
OVER_FRICTION = ("fig4", "fig9", "fig11", "fig12")
"""Figures of the families that start at their gaits."""


class Kind(StrEnum):
    """What is computed from a gait's problem."""

    FAMILY = "family"
    ROUNDED = "rounded torques"
    GAIT = "gait"


Need = tuple[Kind, str]
"""A kind, and the short name of a gait."""
EVERYTHING: Sequence[Need] = (
    *((Kind.FAMILY, name) for name in reversed(tuple(FAMILIES))),
    *((Kind.ROUNDED, name) for name in ROUNDED),
    *((Kind.GAIT, name) for name in SOURCES),
)
"""In the order in which it is computed: the longest first, and families before their gaits, which they contain."""


COSTS = {Kind.FAMILY: 3, Kind.ROUNDED: 1, Kind.GAIT: 1}
"""Processor time, in that of one figure."""
CLOSED_LOOP = 3
"""So many times as long take the gaits that track a reference."""


def cost(need: Need) -> int:
    """What a need costs, roughly, in figures."""
    kind, name = need
    return COSTS[kind] * (CLOSED_LOOP if name.startswith("III") else 1)


def needs(parts: Sequence[str]) -> dict[str, set[Need]]:
    """What parts need, the same problem only once."""
    stated = {part: _stated(part) for part in parts}
    every = set().union(*stated.values())
    first: dict[str, Need] = {}
    for need in EVERYTHING:
        if need in every:
            first.setdefault(_identity(need), need)
    return {part: {first[_identity(need)] for need in own} for part, own in stated.items()}


def is_kept(archive: Archive, need: Need) -> bool:
    """Whether there is nothing to compute."""
    kind, name = need
    return kind is not Kind.ROUNDED and (has_family if kind is Kind.FAMILY else has_gait)(archive, name)


def compute(archive: Archive, need: Need) -> None:
    """Compute what is not kept yet, and keep it."""
    kind, name = need
    if kind is Kind.FAMILY:
        family_of(archive, name)
    elif kind is Kind.ROUNDED:
        rounded_torques(archive, name)
    else:
        gait_of(archive, name)


def _stated(part: str) -> set[Need]:
    if part == TABLE:
        return set(EVERYTHING)
    return {(Kind.FAMILY if part in OVER_FRICTION else Kind.GAIT, name) for name in SHOWN[part]}


def _identity(need: Need) -> str:
    kind, name = need
    return f"{kind} {name}" if kind is Kind.ROUNDED else problem_of(name).digest
