"""How one step is cut into arcs and shooting intervals.

Phases follow each other at unknown times; the breakpoints of the control lie at fixed times since the impact.
Both are ends of arcs, and every arc is cut into equal intervals, so that no interval straddles a kink.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gaitopt.mechanics import Mode, ModeSequence

INTERVALS = 14
"""Intervals of a first layout, shared among the arcs by length: about ten digits on the gaits of the paper."""
FEWEST = 2
"""Intervals of even the shortest arc."""
COINCIDENT = 1e-11
"""A switch this close to a breakpoint, relative to the period, is at it, on either side: what the torques then miss is
below rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArcLayout:
    """One arc: part of a phase on one segment of the control.

    ``start`` and ``end`` are either None, when the arc starts (ends) with its phase, or a breakpoint's time [s].
    """

    phase: int
    mode: Mode
    segment: int
    start: float | None
    end: float | None
    intervals: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """All arcs of a step in order."""

    sequence: ModeSequence
    arcs: tuple[ArcLayout, ...]

    @property
    def intervals(self) -> int:
        """Number of shooting intervals; there is one node more."""
        return sum(arc.intervals for arc in self.arcs)

    @property
    def first_nodes(self) -> tuple[int, ...]:
        """Index of the first node of every arc."""
        counts = [arc.intervals for arc in self.arcs]
        return tuple(int(k) for k in np.cumsum([0, *counts[:-1]]))

    def arc_times(self, durations: NDArray[np.float64]) -> list[tuple[float, float]]:
        """Start and end of every arc for given phase durations [s]."""
        switches = np.concatenate([[0.0], np.cumsum(durations)])
        return [
            (
                float(switches[arc.phase]) if arc.start is None else arc.start,
                float(switches[arc.phase + 1]) if arc.end is None else arc.end,
            )
            for arc in self.arcs
        ]

    def node_times(self, durations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Time since impact of every node for given phase durations; shape (K + 1,) [s]."""
        ends = self.arc_times(durations)
        pieces = [np.linspace(a, b, arc.intervals + 1)[:-1] for arc, (a, b) in zip(self.arcs, ends, strict=True)]
        return np.concatenate([*pieces, [ends[-1][1]]])

    def in_order(self, durations: NDArray[np.float64], breakpoints: Sequence[float]) -> bool:
        """Whether every arc keeps to its segment of the control: False once a switch has passed a breakpoint.

        The breakpoints are all those of the control, so that a step which outlasts one that it did not reach is found.
        """
        limits, slack = (-np.inf, *breakpoints, np.inf), COINCIDENT * float(np.sum(durations))
        return all(
            limits[arc.segment] - slack <= start <= end + slack <= limits[arc.segment + 1] + 2 * slack
            for arc, (start, end) in zip(self.arcs, self.arc_times(durations), strict=True)
        )

    def same_arcs(self, other: "Layout") -> bool:
        """Whether both have the same arcs in the same order, on whatever intervals."""
        return [replace(arc, intervals=0) for arc in self.arcs] == [replace(arc, intervals=0) for arc in other.arcs]

    def refined(self, wanted: Sequence[int]) -> "Layout":
        """The same arcs with other numbers of intervals."""
        arcs = tuple(replace(arc, intervals=n) for arc, n in zip(self.arcs, wanted, strict=True))
        return Layout(sequence=self.sequence, arcs=arcs)


def layout(sequence: ModeSequence, durations: ArrayLike, breakpoints: Sequence[float]) -> Layout:
    """Cut the phases at those breakpoints that lie inside them.

    Parameters
    ----------
    durations : of the phases [s], as far as they are known.
    breakpoints : of the control, times since impact [s], ascending.
    """
    switches = np.concatenate([[0.0], np.cumsum(durations)])
    assert switches[-1] > 0, "a step takes time"
    arcs = []
    for phase, mode in enumerate(sequence.phases):
        begin, finish = switches[phase], switches[phase + 1]
        inside = [b for b in breakpoints if begin < b < finish]
        ends: list[float | None] = [None, *inside, None]
        segment = sum(b <= begin for b in breakpoints)
        for k, (start, end) in enumerate(pairwise(ends)):
            length = (finish if end is None else end) - (begin if start is None else start)
            intervals = max(FEWEST, round(INTERVALS * length / switches[-1]))
            arcs.append(
                ArcLayout(phase=phase, mode=mode, segment=segment + k, start=start, end=end, intervals=intervals)
            )
    return Layout(sequence=sequence, arcs=tuple(arcs))
