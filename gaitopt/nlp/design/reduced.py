"""A design in its freed parameters alone: the equations of the step eliminated, nothing smoothed.

    min f(u)    s.t.    rows(u) >= 0 or = 0,          u = (freed parameters, levels)

A level stands for an extremum that is minimised: every value whose extremum it is stays on its side.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.nlp.design.outcome import EXTREMA, RADIUS
from gaitopt.nlp.design.rows import Radius, Row, Values, margin_rows, span_rows
from gaitopt.nlp.design.scalars import Scalars
from gaitopt.nlp.design.sensitivity import Sensitivity, sensitivity
from gaitopt.nlp.design.spectral_radius import ResponseSlope
from gaitopt.nlp.layout import layout
from gaitopt.nlp.multiple_shooting import MultipleShooting
from gaitopt.nlp.newton import Solution, polish
from gaitopt.nlp.rollout import roll_out
from gaitopt.problem import Problem

SOLVED = 1e-10
"""Residual of the equations of the step at a point."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """The reduced problem at one set of freed parameters.

    Attributes
    ----------
    u : ndarray, shape (n_u,) - freed parameters, and levels.
    objective, gradient : of what is minimised, shape (n_u,).
    by_work : derivative of the objective in the absolute work of the motors.
    rows : all constraints.
    sensitivity : the gait.
    """

    u: Array
    objective: float
    gradient: Array
    by_work: float
    rows: tuple[Row, ...]
    sensitivity: Sensitivity

    @property
    def violation(self) -> float:
        """Largest violation of a constraint."""
        return max((row.violation for row in self.rows), default=0.0)


class Reduced:
    """The reduced problem.

    Parameters
    ----------
    problem : objective and constraints.
    free, bounds : the freed parameters by dotted key, and their bounds; shape (2, n_free).
    """

    def __init__(self, problem: Problem, free: tuple[str, ...], bounds: Array) -> None:
        self._problem, self.free, self.bounds = problem, free, bounds
        self.levels = tuple(
            name for name, weight in problem.objective.items() if name in EXTREMA and weight * EXTREMA[name] > 0
        )
        self._slopes: dict[MultipleShooting, ResponseSlope] = {}

    def first(self, transcription: MultipleShooting, w: Array, p: Array, heights: Array | None = None) -> Point | None:
        """The point at nodes, durations and freed parameters ``w``; None where there is no gait.

        ``heights`` are the levels, at their extrema unless given.
        """
        at = polish(transcription, w, p)
        if not at.size < SOLVED or not (transcription.unpack(at.w).durations > 0).all():
            return None
        if not self._in_order(transcription, at.w):
            return self._recut(transcription, at.w, p, heights)
        return self._point(transcription, at, heights)

    def moved(self, point: Point, step: Array) -> Point | None:
        """The point a step (n_u,) away; None where Newton's method finds no gait from here."""
        s, n = point.sensitivity, len(self.free)
        w = s.at.w + s.slopes @ step[:n]
        w[-n:] = np.clip(w[-n:], *self.bounds)  # to which the step keeps up to rounding
        return self.first(s.transcription, w, s.at.p, point.u[n:] + step[n:])

    def _in_order(self, t: MultipleShooting, w: Array) -> bool:
        return t.layout.in_order(t.unpack(w).durations, t.system.control.breakpoints)

    def _recut(self, t: MultipleShooting, w: Array, p: Array, heights: Array | None) -> Point | None:
        """The same gait on the arcs that it has after a switch has passed a breakpoint of the control."""
        nodes, durations, freed = t.unpack(w)
        rolled = roll_out(t.dynamics(p, freed), t.layout.cycle, nodes[:, 0], list(durations))
        plan = layout(t.layout.cycle, durations, t.system.control.breakpoints)
        cut = MultipleShooting(t.system, plan, t.free)
        at = polish(cut, cut.pack(rolled.nodes(plan), durations, freed), p)
        return self._point(cut, at, heights) if at.size < SOLVED and self._in_order(cut, at.w) else None

    def _point(self, t: MultipleShooting, at: Solution[MultipleShooting], heights: Array | None) -> Point | None:
        try:
            s = sensitivity(t, at)
        except RuntimeError:  # singular
            return None
        freed = s.transcription.unpack(s.at.w).freed
        values = Values(Scalars(s), self._radius(s), self.levels, heights)
        if values.escaped(self._problem):
            return None
        objective, by_work, gradient = 0.0, 0.0, np.zeros(freed.size + len(self.levels))
        for name, weight in self._problem.objective.items():
            value, slope = values.level(name) if name in self.levels else values.single(name)
            objective, gradient = objective + weight * value, gradient + weight * slope
            by_work += weight * values.scalars.by_work(name)
        rows = [*margin_rows(values), *self._within(values, freed)]
        for name in self.levels:
            rows += values.beyond(name, *values.level(name), EXTREMA[name])
        for name, span in self._problem.constraints.items():
            rows += span_rows(values, name, span)
        u = np.concatenate([freed, values.heights])
        return Point(
            u=u, objective=float(objective), gradient=gradient, by_work=by_work, rows=tuple(rows), sensitivity=s
        )

    def _radius(self, s: Sensitivity) -> Radius | None:
        if RADIUS not in self._problem.objective and RADIUS not in self._problem.constraints:
            return None
        if s.transcription not in self._slopes:
            self._slopes[s.transcription] = ResponseSlope(s.transcription)
        return Radius(s, self._slopes[s.transcription])

    def _within(self, values: Values, freed: Array) -> Iterator[Row]:
        """The bounds of the freed parameters."""
        for name, value, slope, (low, high) in zip(self.free, freed, np.eye(freed.size), self.bounds.T, strict=True):
            gradient = values.extended(slope)
            yield Row(about=name, key=f"{name} lower", value=float(value - low), gradient=gradient)
            yield Row(about=name, key=f"{name} upper", value=float(high - value), gradient=-gradient)
