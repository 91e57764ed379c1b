"""The curve of gaits with one mode sequence in one parameter: the points of ``arclength`` with their gaits.

    F(w) = 0,      y = (section state after impact, durations, parameter) / scales

F are the equations of multiple shooting with the parameter as one more unknown. Arclength does not depend on the mesh.
The durations belong to y because they alone move along the curve where a slip velocity or a cone margin grazes zero.

With two parameters the gaits are a surface, on which a ``condition`` g(w) = 0 draws a curve: that of a special point.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, overload

import numpy as np

from gaitopt.arrays import Array
from gaitopt.branches.codimension_two import DEGENERATE, curve_tests, degeneracy
from gaitopt.branches.conditions import Condition, Conditioned, ConditionedEquations
from gaitopt.branches.monitors import MonitorValue, TestFunction, monitor_values, test_functions
from gaitopt.branches.normal_forms import LocalMap, local_map
from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait.branch import ContinuationState
from gaitopt.gait.gait import Gait
from gaitopt.gait.trace import MonitorKey
from gaitopt.model.cycle import Cycle
from gaitopt.model.open_loop import OpenLoop
from gaitopt.problem.problem import Problem
from gaitopt.requests import Method
from gaitopt.solver import arclength
from gaitopt.solver.arclength import Point, SolutionCurve, located
from gaitopt.solver.assembly import assemble_gait
from gaitopt.solver.newton import LARGEST_ERROR, GaitEquations, Solution, halved, refine
from gaitopt.solver.rollout import FIRST_ERROR, Rollout, retraced, rolled_again
from gaitopt.solver.shooting import MultipleShooting
from gaitopt.solver.solve import free_parameters
from gaitopt.threads import cached_property

LEAST_GAIN = 4.0
"""Factor by which a mesh with all intervals halved must reduce the integration error; the order of a step gives 256."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Metric:
    """The scales of arclength, the same along a whole family.

    Attributes
    ----------
    state : ndarray, shape (n_z,) - scale of each coordinate of the state after impact: its natural unit times the
        largest coordinate of the first gait in natural units.
    period : period of the first gait [s].
    span : range of the parameter that has arclength one; that of the last parameter if there are two.
    others : such ranges of the parameters before the last one; empty for a curve in one parameter.
    """

    state: Array
    period: float
    span: float
    others: tuple[float, ...] = ()

    @staticmethod
    def of(gait: Gait, span: float, others: tuple[float, ...] = ()) -> "Metric":
        """The metric of the family that begins with ``gait``."""
        unit = gait.dynamics.state_units
        size = unit * float(np.abs(gait.state / unit).max())
        return Metric(state=size, period=gait.scalar("period"), span=span, others=others)

    @staticmethod
    def from_array(values: Array, others: int = 0) -> "Metric":
        """The metric that ``to_array`` has written, with this number of other parameters."""
        *head, span = values.tolist()
        state, period, spans = head[: -1 - others], head[-1 - others], head[len(head) - others :]
        return Metric(state=np.array(state), period=period, span=span, others=tuple(spans))

    def to_array(self) -> Array:
        """Scales of the state, period and spans, that of the last parameter at the end; shape (n_z + 1 + n_free,)."""
        return np.array([*self.state, self.period, *self.others, self.span])

    @property
    def in_first(self) -> "Metric":
        """The metric of families in the first parameter alone."""
        return replace(self, others=(), span=self.others[0])

    def distance(self, first: Array, second: Array) -> float:
        """Largest scaled difference of two states after impact."""
        return float(np.abs((first - second) / self.state).max())


@dataclass(frozen=True, kw_only=True)
class CurvePoint:
    """A point of a curve; its gait, monitors and test functions are computed on first use.

    Attributes
    ----------
    curve : the curve.
    problem : the problem with the values of the parameters at this point.
    point : the unknowns and the tangent at this point.
    """

    curve: "Curve"
    problem: Problem
    point: Point[Any]

    @property
    def at(self) -> Solution:
        """Unknowns, equalities and Jacobian."""
        at: Solution | Conditioned = self.point.at
        return at.solution if isinstance(at, Conditioned) else at

    @property
    def tangent(self) -> Array:
        """Direction of the curve, of unit length in y; shape of w."""
        return self.point.tangent

    @property
    def direction(self) -> Array:
        """The tangent in the coordinates y."""
        return self.curve.solutions.coordinates(self.tangent)

    @property
    def value(self) -> float:
        """The parameter, the last one if there are two."""
        return float(self.at.w[-1])

    @property
    def values(self) -> dict[str, float]:
        """The free parameters by dotted key."""
        free = self.curve.equations.free
        return dict(zip(free, self.at.w[-len(free) :].tolist(), strict=True))

    @cached_property
    def gait(self) -> Gait:
        """The gait. Its freed parameters include the values of a design, which are constant along the curve."""
        solver: dict[str, float | str] = {"method": Method.NEWTON.value, "iterations": float(self.point.iterations)}
        errors, system, law = np.zeros(self.at.equations.n_phases), self.at.equations.system, self.problem.control
        designed = [*free_parameters(self.problem, system)]
        if isinstance(law, OpenLoop) and law.duration is not None:
            designed += [f"control.{name}.{k}" for name in law.values for k in range(law.count)]
            solver["duration"] = law.duration
        gait = assemble_gait(self.problem, self.at, message="continued", solver=solver, errors=errors)
        return replace(gait, freed={key: gait.dynamics.parameter(key) for key in designed} | dict(gait.freed))

    @property
    def is_regular(self) -> bool:
        """Whether the return map has a derivative; it has none if phases of no duration have no event."""
        try:
            return self.gait.converged
        except RuntimeError:  # the equations are singular
            return False

    @cached_property
    def monitors(self) -> dict[MonitorKey, MonitorValue]:
        """Monitors of the mode sequence."""
        return monitor_values(self.gait)

    @cached_property
    def tests(self) -> dict[str, float]:
        """Test functions of bifurcations by name."""
        return test_functions(self.gait.multipliers, float(self.tangent[-1]))

    @cached_property
    def local(self) -> LocalMap:
        """Derivatives of the return map, to third order."""
        return local_map(self.at)

    @cached_property
    def curve_tests(self) -> dict[str, float]:
        """Test functions of codimension-two points on a curve with a condition, of the multipliers, by their types."""
        condition = self.curve.condition
        return {} if condition is None else curve_tests(self.local, condition.kind, condition.kappa)

    @cached_property
    def _degeneracy(self) -> float:
        condition = self.curve.condition
        assert condition is not None
        return degeneracy(self.local, condition.kind, condition.kappa)

    def curve_test(self, name: str, reference: "CurvePoint") -> float:
        """Value of one of them, or of the coefficient of the normal form, whose derivatives are of third order.

        That of a fold is taken with the critical eigenvector along that at another point.
        """
        if name not in DEGENERATE.values():
            return self.curve_tests[name]
        if name != "cusp":
            return self._degeneracy
        here, there = (point.local.critical("fold")[1] for point in (self, reference))
        return -self._degeneracy if here @ there < 0 else self._degeneracy

    def monitor(self, key: MonitorKey) -> float:
        """Value of one monitor; infinite if this gait does not have it."""
        return self.monitors[key].value if key in self.monitors else np.inf

    def test(self, name: str) -> float:
        """Value of one test function."""
        return self.tests[name]

    def evaluate(self, function: TestFunction) -> float:
        """Value of a function of the gait."""
        return float(function(self.gait))

    def lost(self, before: "CurvePoint") -> list[MonitorKey]:
        """Monitors that were positive at the point ``before`` and are not positive here."""
        return [key for key in self.monitors if self.monitor(key) <= 0 < before.monitor(key)]

    @property
    def in_order(self) -> bool:
        """Whether no switch has passed a breakpoint of the control; also True if a phase has vanished."""
        equations = self.at.equations
        durations, breakpoints = equations.unpack(self.at.w).durations, equations.system.control.breakpoints
        return bool(durations.min() <= 0) or equations.mesh.in_order(durations, breakpoints)

    @property
    def state(self) -> ContinuationState:
        """The state from which the continuation can be resumed at this point."""
        equations, curve = self.at.equations, self.curve
        origins = [float(curve.p[equations.system.parameters.index(key)]) for key in equations.free]
        return ContinuationState(
            unknowns=self.at.w,
            direction=self.tangent,
            arcs=tuple((arc.phase, int(arc.segment), arc.start, arc.end, arc.intervals) for arc in equations.mesh.arcs),
            origin=origins[-1],
            others=tuple(origins[:-1]),
            metric=curve.metric.to_array(),
            earlier=int(self.point.earlier is not None),
        )

    def step(self, length: float) -> "CurvePoint | None":
        """The point at arclength ``length`` along the tangent; None if Newton's method does not converge.

        Raises
        ------
        ProblemError
            If the parameter is beyond the range that the problem allows.
        """
        return self.curve.with_gait(self.curve.solutions.step(self.point, length))

    def at_parameter(self, value: float) -> "CurvePoint | None":
        """The point next to this one with the given value of the parameter; None if Newton's method fails."""
        return self.curve.with_gait(self.curve.solutions.at_parameter(self.point, value))

    def locate(self, after: "CurvePoint", length: float, function: "Callable[[CurvePoint], float]") -> "Location":
        """The zero of ``function`` on the step of the given arclength from here to ``after``."""

        def step(arclength: float) -> "CurvePoint | None":
            try:
                point = self.step(arclength)
            except ProblemError:  # Newton's method has left the range that the problem allows
                return None
            return point if point is not None and point.is_regular else None

        return located(self, after, length, step, function)

    def remeshed(self) -> "CurvePoint | None":
        """The same gait on a finer mesh where its integration error needs one; None if that fails."""
        if self.curve.condition is not None:
            error = self.integration_error
            finer = self._traced_again() if LARGEST_ERROR < error < np.inf else None
            # where rounding causes the error, as next to a singular gait, a finer mesh does not help
            return self if finer is None or finer.integration_error > error / LEAST_GAIN else finer
        refined = refine(self.at)
        return self if refined.equations is self.at.equations else self._resampled(refined)

    def bisected(self) -> "CurvePoint | None":
        """The same gait down to rounding with every interval cut in two; None if that fails."""
        return self._resampled(halved(self.at)) if self.curve.condition is None else self._traced_again()

    @property
    def integration_error(self) -> float:
        """Change of the unknowns, in natural units, that a finer integration would cause across the curve."""
        right = np.zeros(self.at.w.size)
        right[: self.at.halving.size] = self.at.halving
        try:
            change = self.point.bordered.solve(right)
        except RuntimeError:  # singular
            return np.inf
        return float(np.abs(change / self.curve.solutions.equations.unknown_units).max())

    def _traced_again(self) -> "CurvePoint | None":
        """The next point of the curve with every interval cut in two; the parameters may move, as both are free."""
        finer = halved(self.at)
        curve = replace(self.curve, equations=finer.equations)
        return curve.with_gait(curve.solutions.across(finer.w, self.direction))

    def reordered(self) -> "CurvePoint | None":
        """The same gait with its arcs in the order that its durations imply; its modes do not change.

        None if it cannot have them, or if a condition holds along the curve.
        """
        curve = self.curve
        if curve.condition is not None:
            return None
        ordered, w = curve_through(curve.problem, curve.parameter, curve.metric, rolled_again(self.at))
        if ordered.cycle != curve.cycle:  # the torques jump at the breakpoint, which changes the modes
            return None
        first = ordered.start(w, self.direction)
        return first if first is not None and first.in_order else None

    def _resampled(self, at: Solution) -> "CurvePoint | None":
        """The point on the curve of another mesh, where ``at`` is its solution."""
        curve = replace(self.curve, equations=at.equations)
        plain = Solution(at.equations, at.w, at.p)  # with its own Jacobian, without a chord
        return curve.with_gait(curve.solutions.through(plain, self.direction))


Location = arclength.Location[CurvePoint]


@dataclass(frozen=True, eq=False)
class Curve:
    """The gaits that solve the equations of one mode sequence in their free parameter, or in two with a condition.

    Attributes
    ----------
    problem : a problem with the modes of the curve.
    parameter : dotted key of the free parameter; the key of the last one if two are free.
    equations : the shooting equations, in which the parameters are free.
    p : ndarray - values of all parameters; the values of the free ones only decide the units of the equations.
    metric : scales of arclength.
    condition : the condition that holds along a curve in two parameters; None for one parameter.
    """

    problem: Problem
    parameter: str
    equations: MultipleShooting
    p: Array
    metric: Metric
    condition: Condition | None = None

    @cached_property
    def solutions(self) -> SolutionCurve[Any]:
        """The curve of the unknowns."""
        section, metric = self.equations.system.section(self.cycle).indices, self.metric
        n_w, n_phases, spans = self.equations.w.numel(), self.equations.n_phases, [*metric.others, metric.span]
        indices = np.concatenate([section, np.arange(n_w - len(spans) - n_phases, n_w)])
        scales = np.concatenate([metric.state[section], np.full(n_phases, metric.period), spans])
        gaits = GaitEquations(self.equations, self.p, (*metric.others, metric.span))
        if self.condition is None:
            return SolutionCurve(gaits, indices, scales)
        return SolutionCurve(ConditionedEquations(gaits, self.condition, indices, scales), indices, scales)

    @property
    def cycle(self) -> Cycle:
        """The modes of this curve."""
        return self.equations.mesh.cycle

    def start(self, w: Array, forward: Array) -> CurvePoint | None:
        """The gait near ``w`` at the same parameter, on a mesh that is fine enough; None if Newton's method fails.

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
    def with_gait(self, point: Point[Any]) -> CurvePoint: ...

    @overload
    def with_gait(self, point: Point[Any] | None) -> CurvePoint | None: ...

    def with_gait(self, point: Point[Any] | None) -> CurvePoint | None:
        """A point of the curve of unknowns as a gait.

        Raises
        ------
        ProblemError
            If the parameter is beyond the range that the problem allows.
        """
        if point is None:
            return None
        free = self.equations.free
        problem = self.problem.replace(dict(zip(free, point.at.w[-len(free) :].tolist(), strict=True)))
        return CurvePoint(curve=self, problem=problem, point=point)


def curve_through(
    problem: Problem,
    parameter: str,
    metric: Metric,
    rolled: Rollout,
    intervals: Sequence[int] = (),
    *,
    error: float = FIRST_ERROR,
    others: tuple[str, ...] = (),
    condition: Condition | None = None,
) -> tuple[Curve, Array]:
    """A curve on a mesh for a rolled out motion, and the unknowns w of that motion.

    Parameters
    ----------
    others, condition : dotted keys of the free parameters before ``parameter``, and the condition that holds along the
        curve.
    intervals : number of intervals of every arc; ignored if the motion has another number of arcs.
    error : largest error of one interval in natural units.
    """
    start = rolled.on_mesh((*others, parameter), intervals, error=error)
    return Curve(problem, parameter, start.equations, start.p, metric, condition), start.w


def first_point(gait: Gait, parameter: str, metric: Metric, sign: float) -> CurvePoint:
    """A gait on its curve; along the tangent, the parameter increases if ``sign`` is positive, and decreases otherwise.

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
