"""What the paper says about its gaits without a number, examined on the computed families."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.paper.archive import Archive
from gaitopt.paper.gaits import family_of
from gaitopt.paper.numbers import ratio, scalar

LINE_WIDTH = 1e-3
"""Of the height of a curve: the paper shows no less."""


@dataclass(frozen=True, slots=True)
class Sentence:
    """A statement.

    Attributes
    ----------
    where : place in the paper.
    words : what it says.
    holds : whether it does.
    """

    where: str
    words: str
    holds: Callable[[Archive], bool]


def _column(archive: Archive, name: str, key: str, *, slipping_impact: bool = False) -> Array:
    """A scalar at the points of a family, by falling friction."""
    points = [record for record in family_of(archive, name) if record["record"] == "point"]
    points.sort(key=lambda record: -record["value"])
    return np.array([p[key] for p in points if not slipping_impact or p["impact"] != "stick"])


def _rises(values: Array) -> bool:
    """Whether a curve never falls by more than its drawn line is wide."""
    return bool(np.all(np.diff(values) >= -LINE_WIDTH * np.ptp(values)))


def _rises_then_falls(values: Array) -> bool:
    top = int(np.argmax(values))
    return 0 < top < len(values) - 1 and _rises(values[: top + 1]) and _rises(-values[top:])


def _beyond_sticking(name: str, sticking: str) -> Callable[[Archive], bool]:
    """Whether gaits with a slipping impact exist at more friction than the sticking gait needs."""

    def holds(archive: Archive) -> bool:
        values = _column(archive, name, "value", slipping_impact=True)
        return bool(values.max() > scalar(sticking, "required_friction")(archive))

    return holds


SENTENCES = (
    Sentence(
        "IV, Fig. 9",
        "λ of A rises as friction falls",
        lambda archive: _rises(_column(archive, "passive", "spectral_radius")),
    ),
    Sentence(
        "IV, Fig. 9",
        "B is unstable throughout",
        lambda archive: bool(_column(archive, "B", "spectral_radius", slipping_impact=True).min() > 1),
    ),
    Sentence("IV", "B exists for μ > μ_c too", _beyond_sticking("B", "passive")),
    Sentence(
        "V, Fig. 11",
        "I: as friction falls, the cost first rises and then falls",
        lambda archive: _rises_then_falls(_column(archive, "I", "cost_of_transport")),
    ),
    Sentence("V", "I: the speed falls with the friction", lambda archive: _rises(-_column(archive, "I", "speed"))),
    Sentence(
        "V, Fig. 12",
        "I: λ rises as friction falls",
        lambda archive: _rises(_column(archive, "I", "spectral_radius")),
    ),
    Sentence("V", "II is unstable at μ = 0.2", lambda archive: scalar("II", "spectral_radius")(archive) > 1),
    Sentence(
        "V",
        "II costs a quarter of I, to one digit",
        lambda archive: round(ratio(scalar("I", "cost_of_transport"), scalar("II", "cost_of_transport"))(archive)) == 4,
    ),
    Sentence("V", "III is stable at μ = 0.2", lambda archive: scalar("III", "spectral_radius")(archive) < 1),
    Sentence("V", "III slips after the impact for μ > μ_c of I too", _beyond_sticking("III", "I")),
)
"""All of them, in the order of the text."""
