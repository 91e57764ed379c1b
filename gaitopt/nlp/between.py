"""Margins between the nodes: points inside the arcs where they have to hold as well.

At the optimum of a design a margin is often at its edge in the middle of an interval. There the margin's minimum is
made a point of the NLP, at a fixed fraction of its arc; solved again, the minimum moves away from the point only to
second order. The exchange method of semi-infinite programming, Hettich & Kortanek (1993).
"""

from dataclasses import dataclass

import numpy as np
from casadi import MX, vertcat
from numpy.typing import NDArray

from gaitopt.gait import Gait, curves
from gaitopt.mechanics import margin_names
from gaitopt.nlp.integrator import shooting_step
from gaitopt.nlp.transcription import Transcription

Array = NDArray[np.float64]

WATCHED = ("normal_force", "cone_forward", "cone_backward", "slip_velocity", "painleve")


@dataclass(frozen=True, slots=True, kw_only=True)
class Touch:
    """A margin to be held inside an arc.

    Attributes
    ----------
    arc : index of the arc.
    fraction : where in the arc, between 0 and 1.
    name : of the margin.
    """

    arc: int
    fraction: float
    name: str


def touches(gait: Gait, tolerance: float) -> list[Touch]:
    """Where margins have minima below ``-tolerance`` inside the arcs of a gait."""
    assert gait.steps
    found = []
    for index, arc in enumerate(gait.arcs):
        data = gait.system.control.data(arc.segment)
        values = np.asarray(gait.system.margins(arc.mode)(arc.times[None, :], arc.states.T, gait.p, data))
        for name, row in zip(margin_names(arc.mode), values, strict=True):
            at, negative = curves.maximum(-row)
            if name in WATCHED and negative > tolerance and abs(at) < 1:
                found.append(Touch(arc=index, fraction=(at + 1) / 2, name=name))
    return found


def touched_margins(transcription: Transcription, points: list[Touch]) -> MX:
    """The margins at ``points`` as expressions; shape (n,)."""
    rows = []
    for point in points:
        arc, Z, start, h = transcription.arc(point.arc)
        k = min(int(point.fraction * arc.intervals), arc.intervals - 1)
        data = MX(transcription.system.control.data(arc.segment))
        offset = (point.fraction * arc.intervals - k) * h
        z = shooting_step(transcription.system, arc.mode)(Z[:, k], start + k * h, offset, transcription.p, data)
        margins = transcription.system.margins(arc.mode)(start + k * h + offset, z, transcription.p, data)
        rows.append(margins[margin_names(arc.mode).index(point.name)])
    return vertcat(*rows) if rows else MX(0, 1)
