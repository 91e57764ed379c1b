"""The motion behind a JSON record, integrated again from its state, its modes and their durations."""

from collections.abc import Mapping, Sequence
from itertools import count, pairwise
from typing import Any

import numpy as np

from gaitopt.gait import Arc, Step, curves
from gaitopt.mechanics import Dynamics, Mode
from gaitopt.nlp import integrate_to
from gaitopt.nlp.assembly import impact_record

POINTS = 33
"""Chebyshev points of a phase; they resolve a phase of walking."""


def recorded_steps(dynamics: Dynamics, record: Mapping[str, Any], points: int = POINTS) -> tuple[Step, ...]:
    """The steps of a gait, or of a point of a branch.

    Parameters
    ----------
    dynamics : at the parameters for which the record holds.
    record : with the keys ``state``, ``phases`` and ``impact``, or ``steps``.
    points : Chebyshev points of every phase.
    """
    sides = map(dynamics.system.walker.side, count())
    return tuple(
        _integrated(dynamics.standing(side), step, points, side)
        for side, step in zip(sides, record.get("steps", (record,)), strict=False)
    )


def _integrated(dynamics: Dynamics, record: Mapping[str, Any], points: int, side: int) -> Step:
    """One step from the record of its state after impact, its phases and its impact."""
    system, p = dynamics.system, dynamics.p
    z = np.array([record["state"][name] for name in system.state_names])
    time, arcs = 0.0, list[Arc]()
    for phase in record["phases"]:
        mode = Mode.from_record(phase)
        if arcs and mode.locked != arcs[-1].mode.locked:  # a stop has locked
            z = dynamics.after_impact(mode, z)
        if mode.sticks:
            z[-1] = 0.0
        for start, end, segment in _segments(time, time + phase["duration"], system.control.breakpoints):
            times = start + (end - start) * (curves.points(points) + 1) / 2
            states = integrate_to(system, mode, z, times, p, system.control.data(segment))
            arcs.append(Arc(mode=mode, segment=segment, times=times, states=states, side=side))
            z = states[-1].copy()
        time += phase["duration"]
    return Step(arcs=tuple(arcs), impact=impact_record(dynamics, Mode(record["impact"]), z))


def _segments(start: float, end: float, breakpoints: Sequence[float]) -> list[tuple[float, float, int]]:
    """Pieces of [start, end] between the control's breakpoints, each with its segment."""
    cuts = [start, *(b for b in breakpoints if start < b < end), end]
    middles = [(a + b) / 2 for a, b in pairwise(cuts)]
    segments = np.searchsorted(breakpoints, middles, side="right")
    return [(a, b, int(k)) for a, b, k in zip(cuts[:-1], cuts[1:], segments, strict=True)]
