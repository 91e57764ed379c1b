"""The mesh of a cycle: its phases are cut into arcs, and the arcs into shooting intervals.

    t_k = t_start + k (t_end - t_start) / n,      k = 0 .. n      on every arc

Phases end at unknown times; the breakpoints of the control are at fixed times since the impact. Arcs end at both, so
that the motion is smooth in every interval. A timed phase ends at a breakpoint, and so does its last arc. Between two
impacts (of the foot or of a stop) there is one more node than there are intervals: the first node is just after one
impact, the last one just before the next.
"""

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gaitopt.arrays import Array
from gaitopt.model.cycle import Cycle, ModeSequence
from gaitopt.model.modes import Mode
from gaitopt.requests import INTERVALS
from gaitopt.threads import cached_property

FEWEST_INTERVALS = 2
"""Smallest number of intervals of an arc."""
COINCIDENT = 1e-11
"""A switch this close to a breakpoint, relative to the period, coincides with it: the error of the torques is below
rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshArc:
    """One arc: a phase, or its piece on one segment of the control.

    ``start`` and ``end`` are the times of breakpoints [s], or None if the arc starts or ends with its phase.
    """

    phase: int
    mode: Mode
    segment: int
    start: float | None
    end: float | None
    intervals: int


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """All arcs of a cycle in order."""

    cycle: Cycle
    arcs: tuple[MeshArc, ...]

    @cached_property
    def intervals(self) -> int:
        """Number of shooting intervals."""
        return sum(arc.intervals for arc in self.arcs)

    @property
    def n_nodes(self) -> int:
        """Number of nodes: one more than intervals for every impact."""
        return self.intervals + len(self.cycle.resets)

    @cached_property
    def arc_intervals(self) -> tuple[slice, ...]:
        """The intervals of every arc."""
        ends = accumulate(arc.intervals for arc in self.arcs)
        return tuple(slice(end - arc.intervals, end) for end, arc in zip(ends, self.arcs, strict=True))

    @cached_property
    def arc_nodes(self) -> tuple[range, ...]:
        """The nodes of every arc. It shares the first and the last one with its neighbours, except across a reset."""
        resets, nodes = [phase for phase, _ in self.cycle.resets], list[range]()
        for arc, at in zip(self.arcs, self.arc_intervals, strict=True):
            passed = bisect_left(resets, arc.phase)
            nodes.append(range(at.start + passed, at.stop + passed + 1))
        return tuple(nodes)

    @cached_property
    def start_nodes(self) -> NDArray[np.intp]:
        """Index of the node at which every interval starts, shape (intervals,); the interval ends at the next one."""
        return np.concatenate([np.arange(at.start, at.stop - 1) for at in self.arc_nodes])

    @cached_property
    def last_nodes(self) -> tuple[int, ...]:
        """Index of the last node of every phase."""
        return tuple({arc.phase: at[-1] for arc, at in zip(self.arcs, self.arc_nodes, strict=True)}.values())

    @property
    def impact_nodes(self) -> tuple[int, ...]:
        """Index of the node just before the impact of every step."""
        return tuple(self.last_nodes[following - 1] for following in (*self.cycle.first_phases[1:], 0))

    @property
    def reset_nodes(self) -> tuple[int, ...]:
        """Index of the node just before every impact, of the foot or of a stop."""
        return tuple(self.last_nodes[phase] for phase, _ in self.cycle.resets)

    @cached_property
    def joints(self) -> tuple[list[int], list[int]]:
        """Indices of the last node of every phase, and of the node just after every impact."""
        return list(self.last_nodes), [(node + 1) % self.n_nodes for node in self.reset_nodes]

    def arc_times(self, durations: Iterable[Any]) -> list[tuple[Any, Any]]:
        """Start and end of every arc since the last impact [s]; the phase durations may be numbers or symbols."""
        phases: list[tuple[Any, Any]] = []
        for phase, duration in enumerate(durations):
            start = 0.0 if phase in self.cycle.first_phases else phases[-1][1]
            phases.append((start, start + duration))
        return [
            (
                phases[arc.phase][0] if arc.start is None else arc.start,
                phases[arc.phase][1] if arc.end is None else arc.end,
            )
            for arc in self.arcs
        ]

    def interval_times(self, durations: Array) -> tuple[Array, Array]:
        """Start of every interval since the last impact, and its length; shapes (intervals,) [s]."""
        starts, lengths = np.empty(self.intervals), np.empty(self.intervals)
        for at, (start, end) in zip(self.arc_intervals, self.arc_times(durations), strict=True):
            n = at.stop - at.start
            lengths[at] = (end - start) / n
            starts[at] = start + np.arange(n) * (end - start) / n
        return starts, lengths

    def node_times(self, durations: Array) -> Array:
        """Time since the last impact of every node for given phase durations; shape (n_nodes,) [s]."""
        times = np.empty(self.n_nodes)
        for at, (start, end) in zip(self.arc_nodes, self.arc_times(durations), strict=True):
            times[at.start : at.stop] = np.linspace(start, end, len(at))
        return times

    def in_order(self, durations: Array, breakpoints: Sequence[float]) -> bool:
        """Whether every arc lies in its segment of the control: False once a switch has passed a breakpoint.

        ``breakpoints`` are all those of the control, also those after the end of the step.
        """
        limits, slack = (-np.inf, *breakpoints, np.inf), COINCIDENT * float(np.sum(durations))
        return all(
            limits[arc.segment] - slack <= start <= end + slack <= limits[arc.segment + 1] + 2 * slack
            for arc, (start, end) in zip(self.arcs, self.arc_times(durations), strict=True)
        )

    def refined(self, intervals: Sequence[int]) -> "Mesh":
        """The same arcs with other numbers of intervals."""
        arcs = tuple(replace(arc, intervals=n) for arc, n in zip(self.arcs, intervals, strict=True))
        return Mesh(cycle=self.cycle, arcs=arcs)


def mesh_of(cycle: Cycle, durations: ArrayLike, breakpoints: Sequence[float], intervals: int = INTERVALS) -> Mesh:
    """Cut the phases at those breakpoints that lie inside them; a timed phase ends at the nearest one.

    Parameters
    ----------
    durations : estimates of the phase durations [s].
    breakpoints : breakpoints of the control as ascending times since impact [s].
    intervals : number of intervals of a step, which are divided among its arcs in proportion to their lengths.
    """
    lengths = np.asarray(durations, dtype=float)
    firsts = (*cycle.first_phases, lengths.size)
    arcs = [
        arc
        for step, (first, end) in zip(cycle.steps, pairwise(firsts), strict=True)
        for arc in _step_arcs(step, first, lengths[first:end], breakpoints, intervals)
    ]
    return Mesh(cycle=cycle, arcs=tuple(arcs))


def nearest(breakpoints: Sequence[float], time: float) -> float:
    """The breakpoint that is nearest to a time since impact [s]."""
    return min(breakpoints, key=lambda b: abs(b - time))


def _step_arcs(
    step: ModeSequence, first: int, durations: Array, breakpoints: Sequence[float], intervals: int
) -> Iterator[MeshArc]:
    """Arcs of one step, whose phases are counted from ``first``."""
    switches = np.concatenate([[0.0], np.cumsum(durations)])
    if switches[-1] <= 0:
        raise ValueError(f"the phases of a step last {switches[-1]:g} s in all; their sum must be positive")
    for phase in step.timed:
        switches[phase + 1] = nearest(breakpoints, switches[phase + 1])
    for phase, mode in enumerate(step.phases):
        begin, finish = switches[phase], switches[phase + 1]
        inside = [b for b in breakpoints if begin < b < finish]
        ends: list[float | None] = [None, *inside, None]
        segment = sum(b <= begin for b in breakpoints)
        for k, (start, end) in enumerate(pairwise(ends)):
            length = (finish if end is None else end) - (begin if start is None else start)
            count = max(FEWEST_INTERVALS, round(intervals * length / switches[-1]))
            yield MeshArc(phase=first + phase, mode=mode, segment=segment + k, start=start, end=end, intervals=count)
