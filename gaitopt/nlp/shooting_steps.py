"""The steps of all shooting intervals as numbers: what they begin with, where they lead, how far the nodes are off."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from gaitopt.arrays import Array

if TYPE_CHECKING:
    from gaitopt.nlp.multiple_shooting import MultipleShooting


class Intervals(NamedTuple):
    """What the steps of one arc begin with, as arguments of ``shooting_step``.

    Attributes
    ----------
    nodes : ndarray, shape (m, n_z).
    times : ndarray, shape (m, 1) - at which they start [s].
    length : of each [s].
    p, data : all parameters, as the leg stands, and the segment data of the control.
    """

    nodes: Array
    times: Array
    length: float
    p: Array
    data: Array


def intervals(t: "MultipleShooting", w: Array, p: Array) -> Iterator[Intervals]:
    """Those of every arc at unknowns ``w`` and parameters ``p``."""
    nodes, durations, freed = t.unpack(w)
    layout = t.layout
    for arc, first, (start, end) in zip(layout.arcs, layout.first_nodes, layout.arc_times(durations), strict=True):
        length = (end - start) / arc.intervals
        times = start + length * np.arange(arc.intervals, dtype=float)[:, None]
        own = t.values(p, freed, arc.phase)
        yield Intervals(nodes.T[first : first + arc.intervals], times, length, own, t.system.data(arc.segment))


def stepped(t: "MultipleShooting", w: Array, p: Array, parts: int) -> Array:
    """Where the steps lead, each in some equal parts; shape (intervals, n_z)."""
    ends = []
    for step, (state, times, length, own, data) in zip(t.steps, intervals(t, w, p), strict=True):
        for k in range(parts):
            (state,) = step(state, times + k * length / parts, length / parts, own, data)
        ends.append(state.copy())
    return np.concatenate(ends)


def defects(t: "MultipleShooting", w: Array, ends: Array) -> Array:
    """By how much the nodes differ from the states (intervals, n_z) that the steps lead to; shape (n_z intervals,)."""
    return np.asarray((t.unpack(w).nodes.T[t.layout.end_nodes] - ends).ravel())


def joints(t: "MultipleShooting", w: Array) -> tuple[Array, Array, Array, Array]:
    """What ``conditions`` takes: states at the ends of phases and after resets, durations and freed parameters."""
    nodes, durations, freed = t.unpack(w)
    ends, starts = (nodes.T[at].ravel() for at in t.layout.joints)
    return ends, starts, durations, freed
