"""The curve of gaits with one mode sequence in one parameter: the points of ``arclength`` with their gaits.

    F(w) = 0,      y = (section state after impact, durations, parameter) / scales

F are the equations of multiple shooting with the parameter as one more unknown. Arclength does not depend on the mesh.
The durations belong to y because they alone move along the curve where a slip velocity or a cone margin grazes zero.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import overload

import numpy as np

from gaitopt.arrays import Array
from gaitopt.branches.monitors import MonitorKey, MonitorValue, TestFunction, monitor_values, test_functions
from gaitopt.errors import SolveError
from gaitopt.gait.branch import ContinuationState
from gaitopt.gait.gait import Gait
from gaitopt.model.cycle import Cycle
from gaitopt.model.open_loop import OpenLoop
from gaitopt.problem.problem import Problem
from gaitopt.requests import Method
from gaitopt.solver import arclength
from gaitopt.solver.arclength import Point, SolutionCurve, located
from gaitopt.solver.assembly import assemble_gait
from gaitopt.solver.newton import GaitEquations, Solution, halved, refine
from gaitopt.solver.rollout import FIRST_ERROR, Rollout, retraced, rolled_again
from gaitopt.solver.shooting import MultipleShooting
from gaitopt.solver.solve import free_parameters
from gaitopt.threads import cached_property


@dataclass(frozen=True, slots=True, kw_only=True)
class Metric:
    """The scales of arclength, the same along a whole family.

    Attributes
    ----------
    state : ndarray, shape (n_z,) - scale of each coordinate of the state after impact: its natural unit times the
        largest coordinate of the first gait in natural units.
    period : of the first gait [s].
    span : of the parameter.
    """

    state: Array
    period: float
    span: float

    @staticmethod
    def of(gait: Gait, span: float) -> "Metric":
        """The metric of the family that begins with ``gait``."""
        unit = gait.dynamics.state_units
        return Metric(state=unit * float(np.abs(gait.state / unit).max()), period=gait.scalar("period"), span=span)

    @staticmethod
    def from_array(values: Array) -> "Metric":
        """The metric that ``to_array`` has written."""
        *state, period, span = values.tolist()
        return Metric(state=np.array(state), period=period, span=span)

    def to_array(self) -> Array:
        """Scales of the state, period and span; shape (n_z + 2,)."""
        return np.array([*self.state, self.period, self.span])

    def distance(self, first: Array, second: Array) -> float:
        """Largest scaled difference of two states after impact."""
        return float(np.abs((first - second) / self.state).max())


@dataclass(frozen=True, kw_only=True)
class CurvePoint:
    """A point of a curve; its gait, monitors and test functions are computed on first use.

    Attributes
    ----------
    curve : the curve.
    problem : with the value of the parameter at this point.
    point : its unknowns and tangent.
    """

    curve: "Curve"
    problem: Problem
    point: Point[Solution]

    @property
    def at(self) -> Solution:
        """Unknowns, equalities and Jacobian."""
        return self.point.at

    @property
    def tangent(self) -> Array:
        """Direction of the curve, of unit length in y; shape of w."""
        return self.point.tangent

    @property
    def direction(self) -> Array:
        """The tangent as y."""
        return self.curve.solutions.coordinates(self.tangent)

    @property
    def value(self) -> float:
        """The parameter."""
        return float(self.at.w[-1])

    @cached_property
    def gait(self) -> Gait:
        """The gait; the values that a design has found, which stay along the curve, are among its freed parameters."""
        solver: dict[str, float | str] = {"method": Method.NEWTON.value, "iterations": float(self.point.iterations)}
        errors, system, law = np.zeros(self.at.equations.n_phases), self.at.equations.system, self.problem.control
        found = [*free_parameters(self.problem, system)]
        if isinstance(law, OpenLoop) and law.duration is not None:
            found += [f"control.{name}.{k}" for name in law.values for k in range(law.count)]
            solver["duration"] = law.duration
        gait = assemble_gait(self.problem, self.at, message="continued", solver=solver, errors=errors)
        return replace(gait, freed={key: gait.dynamics.parameter(key) for key in found} | dict(gait.freed))

    @property
    def is_regular(self) -> bool:
        """Whether the return map has a derivative; it has none where phases have no length and nothing ends them."""
        try:
            return self.gait.converged
        except RuntimeError:  # singular
            return False

    @cached_property
    def monitors(self) -> dict[MonitorKey, MonitorValue]:
        """Monitors of the mode sequence."""
        return monitor_values(self.gait)

    @cached_property
    def tests(self) -> dict[str, float]:
        """Test functions of bifurcations by name."""
        return test_functions(self.gait.multipliers, float(self.tangent[-1]))

    def monitor(self, key: MonitorKey) -> float:
        """Value of one monitor; infinite where this gait does not have it."""
        return self.monitors[key].value if key in self.monitors else np.inf

    def test(self, name: str) -> float:
        """Value of one test function."""
        return self.tests[name]

    def evaluate(self, function: TestFunction) -> float:
        """Value of a function of the gait."""
        return float(function(self.gait))

    def lost(self, before: "CurvePoint") -> list[MonitorKey]:
        """Monitors that were positive at the point ``before`` and no longer are."""
        return [key for key in self.monitors if self.monitor(key) <= 0 < before.monitor(key)]

    @property
    def in_order(self) -> bool:
        """Whether no switch has passed a breakpoint of the control; True as well where a phase has vanished."""
        equations = self.at.equations
        durations, breakpoints = equations.unpack(self.at.w).durations, equations.system.control.breakpoints
        return bool(durations.min() <= 0) or equations.mesh.in_order(durations, breakpoints)

    @property
    def state(self) -> ContinuationState:
        """What ``resumed_point`` needs to go on from here."""
        equations, curve = self.at.equations, self.curve
        return ContinuationState(
            unknowns=self.at.w,
            direction=self.tangent,
            arcs=tuple((arc.phase, int(arc.segment), arc.start, arc.end, arc.intervals) for arc in equations.mesh.arcs),
            origin=float(curve.p[equations.system.parameters.index(curve.parameter)]),
            metric=curve.metric.to_array(),
            earlier=int(self.point.earlier is not None),
        )

    def step(self, length: float) -> "CurvePoint | None":
        """The point at arclength ``length`` along the tangent; None if Newton's method does not converge.

        Raises
        ------
        ProblemError
            If the parameter has left the range that the problem allows.
        """
        return self.curve.with_gait(self.curve.solutions.step(self.point, length))

    def at_parameter(self, value: float) -> "CurvePoint | None":
        """The point next to this one with the given value of the parameter; None if Newton's method fails."""
        return self.curve.with_gait(self.curve.solutions.at_parameter(self.point, value))

    def locate(self, after: "CurvePoint", length: float, function: "Callable[[CurvePoint], float]") -> "Location":
        """The zero of ``function`` on the step of the given arclength from here to ``after``."""

        def step(part: float) -> "CurvePoint | None":
            point = self.step(part)
            return point if point is not None and point.is_regular else None

        return located(self, after, length, step, function)

    def remeshed(self) -> "CurvePoint | None":
        """The same gait on a finer mesh where its integration error needs one; None if that fails."""
        refined = refine(self.at)
        return self if refined.equations is self.at.equations else self._resampled(refined)

    def bisected(self) -> "CurvePoint | None":
        """The same gait down to rounding with every interval cut in two; None if that fails."""
        return self._resampled(halved(self.at))

    def reordered(self) -> "CurvePoint | None":
        """The same gait with arcs in the order that its durations demand; its modes do not change."""
        curve = self.curve
        ordered, w = curve_through(curve.problem, curve.parameter, curve.metric, rolled_again(self.at))
        if ordered.cycle != curve.cycle:  # the torques jump where a switch meets a breakpoint
            return None
        first = ordered.start(w, self.direction)
        return first if first is not None and first.in_order else None

    def _resampled(self, at: Solution) -> "CurvePoint | None":
        """The point on the curve of another mesh, where ``at`` is its solution."""
        curve = Curve(self.curve.problem, self.curve.parameter, at.equations, self.curve.p, self.curve.metric)
        plain = Solution(at.equations, at.w, at.p)  # with its own Jacobian, without a chord
        return curve.with_gait(curve.solutions.through(plain, self.direction))


Location = arclength.Location[CurvePoint]


class Curve:
    """The gaits that solve the equations of one mode sequence in their one freed parameter.

    Parameters
    ----------
    problem : with the modes of the curve.
    parameter : dotted key of the parameter.
    equations : with this parameter freed.
    p : ndarray - values of all parameters; the one of ``parameter`` only decides the units of the equations.
    metric : scales of arclength.

    Attributes
    ----------
    solutions : the curve of their unknowns.
    """

    def __init__(self, problem: Problem, parameter: str, equations: MultipleShooting, p: Array, metric: Metric) -> None:
        self.problem, self.parameter, self.equations = problem, parameter, equations
        self.p, self.metric = p, metric
        section = equations.system.section(equations.mesh.cycle).indices
        n_w, n_phases = equations.w.numel(), equations.n_phases
        indices = np.concatenate([section, np.arange(n_w - 1 - n_phases, n_w)])
        scales = np.concatenate([metric.state[section], np.full(n_phases, metric.period), [metric.span]])
        self.solutions = SolutionCurve(GaitEquations(equations, p, metric.span), indices, scales)

    @property
    def cycle(self) -> Cycle:
        """The modes of this curve."""
        return self.equations.mesh.cycle

    def start(self, w: Array, forward: Array) -> CurvePoint | None:
        """The gait next to ``w`` at its parameter, on a mesh that is fine enough; None if Newton's method fails.

        Parameters
        ----------
        forward : ndarray, shape of y - direction of the tangent.
        """
        point = self.with_gait(self.solutions.nearest(w, forward))
        return None if point is None else point.remeshed()

    def branch_off(self, w: Array, direction: Array, length: float) -> CurvePoint | None:
        """The point of another branch through ``w`` whose projection on ``direction`` (shape of w) is ``length``."""
        point = self.with_gait(self.solutions.beside(w, direction, length))
        return None if point is None else point.remeshed()

    @overload
    def with_gait(self, point: Point[Solution]) -> CurvePoint: ...

    @overload
    def with_gait(self, point: Point[Solution] | None) -> CurvePoint | None: ...

    def with_gait(self, point: Point[Solution] | None) -> CurvePoint | None:
        """A point of the curve of unknowns as a gait.

        Raises
        ------
        ProblemError
            If the parameter has left the range that the problem allows.
        """
        if point is None:
            return None
        problem = self.problem.replace({self.parameter: float(point.at.w[-1])})
        return CurvePoint(curve=self, problem=problem, point=point)


def curve_through(
    problem: Problem,
    parameter: str,
    metric: Metric,
    rolled: Rollout,
    intervals: Sequence[int] = (),
    *,
    error: float = FIRST_ERROR,
) -> tuple[Curve, Array]:
    """A curve on a mesh for a rolled out motion, and the unknowns w of that motion.

    Parameters
    ----------
    intervals : of every arc, used if there are as many arcs.
    error : largest error of one interval in natural units.
    """
    start = rolled.on_mesh((parameter,), intervals, error=error)
    return Curve(problem, parameter, start.equations, start.p, metric), start.w


def first_point(gait: Gait, parameter: str, metric: Metric, sign: float) -> CurvePoint:
    """A gait on its curve, with the tangent along which the parameter rises or falls, as ``sign`` says.

    Raises
    ------
    SolveError
        If Newton's method fails at the gait.
    """
    intervals = () if gait.shooting is None else gait.shooting.intervals
    curve, w = curve_through(gait.problem, parameter, metric, retraced(gait), intervals)
    point = curve.start(w, curve.solutions.ahead(sign))
    if point is None:
        raise SolveError(
            f"{gait.problem.name}: the gait cannot be continued in {parameter}: Newton's method fails at it"
        )
    return point
