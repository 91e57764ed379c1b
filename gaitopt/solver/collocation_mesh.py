"""Mesh of a direct collocation: intervals in order, the points of each, and the numbers of their states.

Phases and intervals of the control divide each step. All times since the last impact are affine in the durations d of
the phases and the duration T of the law, which is the mean duration of a step:

    t_start, t_end = coefficients . (1, d, T)            t_j = t_start + c_j (t_end - t_start)

Each interval has its state at the start, which ends the interval before it unless there is an impact between them, and
its states at the Radau points c_j. States at fractions of an interval between these points are interpolated.
"""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from casadi import collocation_coeff, collocation_points

from gaitopt.arrays import Array, ReadOnlyArrays
from gaitopt.model.control import Control
from gaitopt.model.cycle import Cycle
from gaitopt.model.open_loop import OpenLoop, Order

DEGREE = 5
"""Number of Radau points of an interval, by which the states at its end have order 9."""
INTERVALS = 20
"""Smallest number of intervals of a step."""

ExtraPoints = tuple[tuple[int, float], ...]
"""Extra points between the Radau points, each as the number of the interval and the fraction of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """One interval: its phase, the interval of the law (``segment``), and its start and end.

    Start and end are affine in the durations and T: they are the n_phases + 2 coefficients of (1, durations, T).
    """

    phase: int
    segment: int
    start: tuple[float, ...]
    end: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """A point at which margins must not be negative.

    Attributes
    ----------
    interval, fraction : number of its interval, and fraction of it.
    state : index of its state among those of all points.
    dynamic : whether it is a collocation point, at which the equations of motion hold.
    """

    interval: int
    fraction: float
    state: int
    dynamic: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class CollocationMesh:
    """The intervals of a cycle and the positions of their points. Equal meshes have equal programs.

    Attributes
    ----------
    cycle : the phases of all steps.
    intervals : intervals in their order.
    degree : number of Radau points of an interval.
    jumps : whether torques may jump where the interval of the law changes.
    extra : extra points, as (interval, fraction), at which margins must not be negative.
    """

    cycle: Cycle
    intervals: tuple[Interval, ...]
    degree: int
    jumps: bool
    extra: ExtraPoints = ()


def mesh_at(
    cycle: Cycle, control: Control, durations: Array, *, degree: int, count: int, timed: bool, extra: ExtraPoints
) -> CollocationMesh:
    """The mesh with at least ``count`` intervals per step; switches and breakpoints are in the order of the durations.

    Parameters
    ----------
    timed : whether the duration of the law is an unknown of its own; otherwise it is the mean duration of a step.
    """
    m, at = len(cycle.phases), affine(durations, len(cycle.steps))
    mean = np.array([0.0] * (m + 1) + [1.0] if timed else [0.0] + [1.0 / len(cycle.steps)] * m + [0.0])
    intervals = list[Interval]()
    for first, last in pairwise([*cycle.first_phases, m]):
        ends = np.zeros((last - first, m + 2))  # of the phases
        ends[:, 1 + first : 1 + last] = np.tril(np.ones((last - first, last - first)))
        if isinstance(control, OpenLoop):
            grid = [mean * k / control.intervals for k in range(1, control.intervals)]
        else:
            period = float(durations[first:last].sum())
            grid = [np.append(b, np.zeros(m + 1)) for b in control.breakpoints if b < period]
        marks: list[tuple[Array, int | None, int | None]] = [(np.zeros(m + 2), first, 0)]
        marks += [(row, phase + 1, None) for phase, row in enumerate(ends, start=first)]
        marks += [(row, None, k + 1) for k, row in enumerate(grid)]
        marks.sort(key=lambda mark: float(mark[0] @ at))
        finer, phase, segment = int(np.ceil(count / max(1, len(marks) - 1))), first, 0
        for (start, new_phase, new_segment), (end, _, _) in pairwise(marks):
            phase = phase if new_phase is None else new_phase
            segment = segment if new_segment is None else new_segment
            if phase >= last or float((end - start) @ at) <= 0:
                continue
            for k in range(finer):
                begin, finish = (tuple((start + (end - start) * (k + j) / finer).tolist()) for j in (0, 1))
                intervals.append(Interval(phase=phase, segment=segment, start=begin, end=finish))
    jumps = not isinstance(control, OpenLoop) or control.order is Order.CONSTANT
    return CollocationMesh(cycle=cycle, intervals=tuple(intervals), degree=degree, jumps=jumps, extra=extra)


def affine(durations: Array, steps: int) -> Array:
    """The vector (1, durations, T) in which times are linear; T is the mean duration of a step; (n_phases + 2,)."""
    return np.concatenate([[1.0], durations, [durations.sum() / steps]])


def basis(degree: int, fractions: Array) -> Array:
    """Values of the Lagrange polynomials of an interval at fractions of it (n,), shape (n, degree + 1)."""
    tau = np.array([0.0, *collocation_points(degree, "radau")])
    others = [np.delete(tau, k) for k in range(tau.size)]
    columns = [np.prod((fractions[:, None] - b) / (a - b), axis=1) for a, b in zip(tau.tolist(), others, strict=True)]
    return np.stack(columns, axis=1)


@dataclass(frozen=True, kw_only=True)
class Points(ReadOnlyArrays):
    """The points of a mesh and the numbers of their states; made by ``points_of``.

    Attributes
    ----------
    mesh : the mesh.
    all : the points in their order, the extra ones last.
    first : index of the state at the start of each interval.
    inner : index of the state at the first collocation point of each interval.
    phase_starts, phase_ends : indices of the states at both ends of each phase.
    n_states : number of states.
    tau : 0 and the Radau points.
    C : derivatives of the Lagrange polynomials at these points.
    B : weights of the quadrature.
    """

    mesh: CollocationMesh
    all: tuple[Point, ...]
    first: tuple[int, ...]
    inner: tuple[int, ...]
    phase_starts: dict[int, int]
    phase_ends: dict[int, int]
    n_states: int
    tau: Array
    C: Array
    B: Array
    _starts: Array = field(repr=False)
    _ends: Array = field(repr=False)

    def of_interval(self, k: int) -> list[int]:
        """Indices of the states of an interval: at its start and at its collocation points."""
        return [self.first[k], *range(self.inner[k], self.inner[k] + self.mesh.degree)]

    def lengths(self, durations: Array) -> Array:
        """Lengths of the intervals [s], shape (n_intervals,)."""
        return (self._ends - self._starts) @ affine(durations, len(self.mesh.cycle.steps))

    def times(self, durations: Array) -> Array:
        """Times of all states since the last impact [s]."""
        at, times = affine(durations, len(self.mesh.cycle.steps)), np.empty(self.n_states)
        starts, ends = self._starts @ at, self._ends @ at
        times[[*self.first]] = starts
        interval = [pt.interval for pt in self.all]
        fractions = np.array([pt.fraction for pt in self.all])
        times[[pt.state for pt in self.all]] = starts[interval] + fractions * (ends - starts)[interval]
        return times

    def interpolated(self, states: Array, durations: Array, phase: int, times: Array) -> Array:
        """States of the polynomials through ``states`` in a phase, at times since the impact, shape (n, n_z)."""
        at = affine(durations, len(self.mesh.cycle.steps))
        of_phase = np.flatnonzero([interval.phase == phase for interval in self.mesh.intervals])
        starts, ends = self._starts[of_phase] @ at, self._ends[of_phase] @ at
        found = np.maximum(np.searchsorted(starts, times, side="right") - 1, 0)
        weights = basis(self.mesh.degree, (times - starts[found]) / (ends[found] - starts[found]))
        stored = np.array([self.of_interval(k) for k in of_phase.tolist()])
        return np.einsum("nk,nkz->nz", weights, states[stored[found]])


def points_of(mesh: CollocationMesh) -> Points:
    """The points of a mesh."""
    resets = {phase for phase in range(len(mesh.cycle.phases)) if mesh.cycle.reset_after(phase) is not None}
    tau = np.append(0.0, collocation_points(mesh.degree, "radau"))
    C, _, B = collocation_coeff(list(tau[1:]))
    states, points, first, inner = 0, list[Point](), list[int](), list[int]()
    phase_starts, phase_ends = dict[int, int](), dict[int, int]()
    for k, interval in enumerate(mesh.intervals):
        before = mesh.intervals[k - 1] if k else None
        if before is None or (before.phase != interval.phase and before.phase in resets):
            states += 1  # a state of its own, after an impact
        first.append(states - 1)
        phase_starts.setdefault(interval.phase, states - 1)
        jumps = before is not None and mesh.jumps and before.segment != interval.segment
        if before is None or before.phase != interval.phase or jumps:
            points.append(Point(interval=k, fraction=0.0, state=states - 1, dynamic=False))
        inner.append(states)
        for fraction in tau[1:].tolist():
            points.append(Point(interval=k, fraction=fraction, state=states, dynamic=True))
            states += 1
        phase_ends[interval.phase] = states - 1
    for k, fraction in mesh.extra:
        points.append(Point(interval=k, fraction=fraction, state=states, dynamic=False))
        states += 1
    return Points(
        mesh=mesh,
        all=tuple(points),
        first=tuple(first),
        inner=tuple(inner),
        phase_starts=phase_starts,
        phase_ends=phase_ends,
        n_states=states,
        tau=tau,
        C=np.array(C),
        B=np.array(B).ravel(),
        _starts=np.array([interval.start for interval in mesh.intervals]),
        _ends=np.array([interval.end for interval in mesh.intervals]),
    )
