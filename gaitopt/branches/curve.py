"""The curve of gaits with one mode sequence in one parameter, followed by pseudo-arclength.

    F(w) = 0,      n' (y(w) - y_predicted) = 0,      y = (section state after impact, durations, parameter) / scales

F are the equations of multiple shooting with the parameter as one more unknown. Arclength is measured in y alone, so
that it does not depend on the mesh. The durations belong to y because they alone move along the curve where a slip
velocity or a cone margin grazes zero. The Jacobian of the last point serves as long as it contracts (chord method).

At a branch point the Jacobian J has a plane of null vectors. The one perpendicular to the known tangent leads to the
other branch, next to which Newton's method is regular.

References
----------
H. B. Keller (1977), Numerical solution of bifurcation and nonlinear eigenvalue problems.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitopt.arrays import Array, overflow_allowed
from gaitopt.branches.monitors import MonitorKey, MonitorValue, TestFunction, monitor_values, test_functions
from gaitopt.errors import SolveError
from gaitopt.gait.branch import ContinuationState
from gaitopt.gait.gait import Gait
from gaitopt.integration import bracketed_root
from gaitopt.model.cycle import Cycle
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.open_loop import OpenLoop
from gaitopt.problem.problem import Problem
from gaitopt.requests import Method
from gaitopt.solver.assembly import assemble_gait
from gaitopt.solver.mesh import Mesh, MeshArc
from gaitopt.solver.newton import Solution, extrapolation, halved, refine
from gaitopt.solver.rollout import FIRST_ERROR, Rollout, retraced, rolled_again
from gaitopt.solver.shooting import MultipleShooting, transcribe
from gaitopt.solver.solve import free_parameters
from gaitopt.solver.sparse import ScaledMatrix
from gaitopt.threads import cached_property

RESIDUAL = 1e-13
"""Largest violation of an equality on the curve, in natural units: about thirty times the rounding of a step.

One more chord then reaches rounding, also where the equations are so flat that a prediction already satisfies them.
Stiff torques have a larger rounding, in proportion to their gains: see ``SOLVED``.
"""
PRECISION = 1e-11
"""Largest Newton step that may remain at a solution, in natural units: two digits below what the simulator confirms.

A small residual alone is not enough: the end of a slip that has just appeared is a root with a slope near zero.
"""
ITERATIONS = 11
SINGULAR = 1e-5
"""Violation of the linearised equalities by a unit null vector, where the branch point is known to eight digits."""
INVERSE_ITERATIONS = 2
"""The null vector of a matrix that is singular to nine digits is accurate to nine digits after one."""
FORWARD = 0.5
"""Cosine of the angle between tangents below which the curve has turned too far for extrapolation.

Predictions are cubics through two points with their tangents. Three points would save a third of the chords, but where
a gait vanishes they enlarge rounding to 1e-8 of its place.
"""
CONTRACTION = 0.5
"""Ratio of Newton steps above which only rounding is left."""
SLOW = 0.2
"""A chord that contracts by less than this is replaced by a new Jacobian."""
SOLVED = 1e-10
"""Violation of an equality in natural units below which stored unknowns are a gait, and from which a full Newton step
that does not reduce it has met rounding; a point has 1e-13 or less, unless its torques are stiff."""
LENGTH_TOLERANCE = 1e-13
"""In arclength; the parameter is then accurate to more than ten digits of its range."""


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Location:
    """A zero of a function on a step along a curve.

    Attributes
    ----------
    length : arclength from the start of the step.
    point : the gait there.
    status : ``converged``, or ``guess`` for the last known point before it, where Newton's method failed on the way.
    """

    length: float
    point: "CurvePoint"
    status: str


@dataclass(frozen=True, kw_only=True)
class CurvePoint:
    """A point of a curve; its gait, monitors and test functions are computed on first use.

    Attributes
    ----------
    curve : the curve.
    problem : with the value of the parameter at this point.
    at : unknowns, equalities and Jacobian.
    tangent : ndarray, shape of w - direction of the curve, of unit length in y.
    bordered : the Jacobian with this tangent as its last row.
    iterations : number of Newton iterations that led here.
    earlier : unknowns and tangent of the point before this one, from which the next one is extrapolated; None if none.
    """

    curve: "Curve"
    problem: Problem
    at: Solution
    tangent: Array
    bordered: ScaledMatrix
    iterations: int
    earlier: tuple[Array, Array] | None = None

    @property
    def value(self) -> float:
        """The parameter."""
        return float(self.at.w[-1])

    @cached_property
    def gait(self) -> Gait:
        """The gait; the values that a design has found, which stay along the curve, are among its freed parameters."""
        solver: dict[str, float | str] = {"method": Method.NEWTON.value, "iterations": float(self.iterations)}
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
            earlier=int(self.earlier is not None),
        )

    def step(self, length: float) -> "CurvePoint | None":
        """The point at arclength ``length`` along the tangent; None if Newton's method does not converge.

        Raises
        ------
        ProblemError
            If the parameter has left the range that the problem allows.
        """
        coordinates, predictions = self.curve.coordinates, [self.at.w + length * self.tangent]
        normal = coordinates(self.tangent)
        if self.earlier is not None:
            w, tangent = self.earlier
            place = float(normal @ (coordinates(w) - coordinates(self.at.w)))
            slope = float(normal @ coordinates(tangent))
            weights = None if slope < FORWARD else extrapolation([0.0, place], length, slopes=True)
            if weights is not None:
                cubic = weights @ np.array([self.at.w, w, self.tangent, tangent / slope])
                predictions.insert(0, cubic)
        for predicted in predictions:
            end = self.curve.corrected(predicted, normal, self.bordered)
            if end is not None:
                return replace(end, earlier=(self.at.w, self.tangent))
        return None

    @overflow_allowed()
    def at_parameter(self, value: float) -> "CurvePoint | None":
        """The point next to this one with the given value of the parameter; None if Newton's method fails."""
        slope = self.tangent[-1]
        predicted = self.at.w + self.tangent * ((value - self.at.w[-1]) / slope if slope else 0.0)
        predicted[-1] = value
        return self.curve.nearest(predicted, self.curve.coordinates(self.tangent))

    def locate(self, after: "CurvePoint", length: float, function: "Callable[[CurvePoint], float]") -> Location:
        """The zero of ``function`` on the step of the given arclength from here to ``after``."""
        points: dict[float, CurvePoint] = {0.0: self, length: after}

        def value(part: float) -> float:
            if part not in points:
                point = self.step(part)
                if point is None or not point.is_regular:
                    raise _LostError
                points[part] = point
            return function(points[part])

        try:
            root = bracketed_root(value, 0.0, length, LENGTH_TOLERANCE)
        except _LostError:
            last = max(part for part, point in points.items() if function(point) * function(self) >= 0)
            return Location(length=last, point=points[last], status="guess")
        value(root)
        return Location(length=root, point=points[root], status="converged")

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
        first = ordered.start(w, curve.coordinates(self.tangent))
        return first if first is not None and first.in_order else None

    def _resampled(self, at: Solution) -> "CurvePoint | None":
        """The point on the curve of another mesh, where ``at`` is its solution."""
        curve = Curve(self.curve.problem, self.curve.parameter, at.equations, self.curve.p, self.curve.metric)
        plain = Solution(at.equations, at.w, at.p)  # with its own Jacobian, without a chord
        return curve.through(plain, self.curve.coordinates(self.tangent))


class Curve:
    """The solutions of the equations of a gait in their one freed parameter.

    Parameters
    ----------
    problem : with the modes of the curve.
    parameter : dotted key of the parameter.
    equations : with this parameter freed.
    p : ndarray - values of all parameters; the one of ``parameter`` only decides the units of the equations.
    metric : scales of arclength.
    """

    def __init__(self, problem: Problem, parameter: str, equations: MultipleShooting, p: Array, metric: Metric) -> None:
        self.problem, self.parameter, self.equations = problem, parameter, equations
        self.p, self.metric = p, metric
        section = equations.system.section(equations.mesh.cycle).indices
        n_w, n_phases = equations.w.numel(), equations.n_phases
        self._indices = np.concatenate([section, np.arange(n_w - 1 - n_phases, n_w)])
        self._scales = np.concatenate([metric.state[section], np.full(n_phases, metric.period), [metric.span]])
        self._units = equations.units(p)
        self._columns = np.append(self._units.unknowns[:-1], metric.span)

    @property
    def cycle(self) -> Cycle:
        """The modes of this curve."""
        return self.equations.mesh.cycle

    def entries(self, w: Array) -> Array:
        """Section coordinates, durations and parameter, in SI; shape (n_xi + n_phases + 1,)."""
        return np.asarray(w[self._indices])

    def coordinates(self, w: Array) -> Array:
        """The same in the scales of arclength: y."""
        return self.scaled(self.entries(w))

    def scaled(self, entries: Array) -> Array:
        """The ``entries`` of some w as y."""
        return entries / self._scales

    def ahead(self, sign: float) -> Array:
        """The direction in which the parameter alone rises or falls, as ``sign`` says; shape of y."""
        direction = np.zeros(self._indices.size)
        direction[-1] = sign
        return self.scaled(direction)

    def start(self, w: Array, forward: Array) -> CurvePoint | None:
        """The gait next to ``w`` at its parameter, on a mesh that is fine enough; None if Newton's method fails.

        Parameters
        ----------
        forward : ndarray, shape of y - direction of the tangent.
        """
        point = self.nearest(w, forward)
        return None if point is None else point.remeshed()

    def nearest(self, w: Array, forward: Array) -> CurvePoint | None:
        """The point next to ``w`` on this mesh and at the same parameter, its tangent along ``forward``."""
        upright = np.zeros(self._indices.size)
        upright[-1] = 1.0
        return self.corrected(w, upright, forward=forward)

    def branch_off(self, w: Array, direction: Array, length: float) -> CurvePoint | None:
        """The point of another branch through ``w`` whose projection on ``direction`` (shape of w) is ``length``."""
        point = self.corrected(w + length * direction, np.sign(length) * self.coordinates(direction))
        return None if point is None else point.remeshed()

    @overflow_allowed()
    def crossing(self, w: Array, along: Array) -> Array | None:
        """Direction of another branch through ``w``, of unit length in y; None where there is none.

        It is the null vector, by inverse iteration, of the Jacobian bordered by the tangent of the known branch.

        Parameters
        ----------
        along : ndarray, shape of y - tangent of the known branch in scaled coordinates.
        """
        at = Solution(self.equations, w, self.p)
        bordered = self._bordered(at, along)
        vector = np.random.default_rng(0).standard_normal(w.size) / self._columns
        for _ in range(INVERSE_ITERATIONS):
            try:
                vector = bordered.solve(bordered.solve_transposed(vector))
            except RuntimeError:  # singular
                return None
            vector /= np.linalg.norm(self.coordinates(vector))
        left = np.abs(at.jacobian @ vector / self._units.equalities).max()
        return vector if left < SINGULAR else None

    @overflow_allowed()
    def corrected(
        self, predicted: Array, normal: Array, chord: ScaledMatrix | None = None, *, forward: Array | None = None
    ) -> CurvePoint | None:
        """Newton's method from ``predicted`` perpendicular to ``normal``, which becomes the direction of the tangent.

        Parameters
        ----------
        chord : bordered Jacobian for the first steps; None for that at ``predicted``.
        forward : ndarray, shape of y - direction of the tangent, if the parameter must stay exactly as predicted.
        """
        w, last, is_fixed, full = predicted, np.inf, forward is not None, False
        try:
            for iterations in range(ITERATIONS + 1):
                residual = self.equations.violation(w, self.p)
                offset = float(normal @ (self.coordinates(w) - self.coordinates(predicted)))
                size = max(float(np.abs(residual / self._units.equalities).max()), abs(offset))
                slow = size > SLOW * last
                solved = size < RESIDUAL or (full and slow and size < SOLVED)
                if slow:
                    chord = None
                if not solved:
                    if iterations == ITERATIONS or not np.isfinite(size):
                        return None
                    full = chord is None
                    chord = chord or self._bordered(Solution(self.equations, w, self.p), normal)
                if chord is not None:  # also at a solution, where one more chord leads to rounding
                    w = w - chord.solve(np.append(residual, offset))
                    if is_fixed:
                        w[-1] = predicted[-1]  # rounding would move it, perhaps out of its range
                if solved:
                    break
                last = size
        except RuntimeError:  # singular
            return None
        at, bordered = self._polished(Solution(self.equations, w, self.p), normal, is_fixed=is_fixed)
        return (
            self.through(at, normal, iterations, bordered) if forward is None else self.through(at, forward, iterations)
        )

    def _polished(self, at: Solution, normal: Array, *, is_fixed: bool) -> tuple[Solution, ScaledMatrix]:
        """The solution after full Newton steps perpendicular to ``normal``, down to ``PRECISION`` or rounding.

        Returns
        -------
        at, bordered : the solution, and its Jacobian with ``normal`` as the last row.
        """
        best, last = (at, self._bordered(at, normal)), np.inf
        at, bordered = best
        while True:
            try:
                step = bordered.solve(np.append(at.residual, 0.0))
            except RuntimeError:  # singular
                return best
            if is_fixed:
                step[-1] = 0.0
            size = float(np.abs(step / self._columns).max())
            if not size < CONTRACTION * last:
                return best
            if size < PRECISION:
                return at, bordered
            best, last = (at, bordered), size
            at = Solution(self.equations, at.w - step, self.p)
            bordered = self._bordered(at, normal)

    def through(
        self, at: Solution, forward: Array, iterations: int = 0, bordered: ScaledMatrix | None = None
    ) -> CurvePoint | None:
        """A solution as a point of the curve, its tangent along ``forward`` (shape of y); None where it has none.

        Parameters
        ----------
        bordered : Jacobian with ``forward`` as the last row, if it is known.
        """
        right = np.zeros(at.w.size)
        right[-1] = 1.0
        try:
            tangent = (bordered or self._bordered(at, forward)).solve(right)
        except RuntimeError:  # singular
            return None
        return self.point(at, tangent / np.linalg.norm(self.coordinates(tangent)), iterations)

    def point(
        self, at: Solution, tangent: Array, iterations: int, earlier: tuple[Array, Array] | None = None
    ) -> CurvePoint:
        """A solution with a known tangent as a point of the curve."""
        return CurvePoint(
            curve=self,
            problem=self.problem.replace({self.parameter: float(at.w[-1])}),
            at=at,
            tangent=tangent,
            bordered=self._bordered(at, self.coordinates(tangent)),
            iterations=iterations,
            earlier=earlier,
        )

    def _bordered(self, at: Solution, normal: Array) -> ScaledMatrix:
        matrix = at.jacobian.with_row(self._indices, normal / self._scales)
        return ScaledMatrix(matrix, np.append(self._units.equalities, 1.0), self._columns)


class _LostError(Exception):
    """Newton's method did not converge at a trial length."""


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
    point = curve.start(w, curve.ahead(sign))
    if point is None:
        raise SolveError(
            f"{gait.problem.name}: the gait cannot be continued in {parameter}: Newton's method fails at it"
        )
    return point


def resumed_point(
    problem: Problem,
    cycle: Cycle,
    dynamics: Dynamics,
    parameter: str,
    states: Sequence[ContinuationState],
    iterations: int,
) -> CurvePoint:
    """The last of some points from their ``state``, to the last bit.

    Parameters
    ----------
    problem, cycle : with the modes of the curve, and these modes with the phases that are timed.
    dynamics : at the values of all other parameters.
    states : of the last point, and before it that of the point before, if the next one is extrapolated from both.
    iterations : number of Newton iterations that led to the last point.

    Raises
    ------
    ValueError
        If the states do not fit the modes, or the last one is not a gait with them.
    """
    *before, last = states
    system = dynamics.system
    n_nodes = sum(intervals for *_, intervals in last.arcs) + len(cycle.resets)
    sizes = {state.unknowns.size for state in states} | {state.direction.size for state in states}
    if [*dict.fromkeys(arc[0] for arc in last.arcs)] != list(range(len(cycle.phases))):
        raise ValueError(f"walk.arcs do not cover the {len(cycle.phases)} phases in order")
    if sizes != {n_nodes * system.n_z + len(cycle.phases) + 1}:
        raise ValueError("walk.unknowns or walk.direction do not have the size that walk.arcs require")
    if last.metric.size != system.n_z + 2 or last.metric.min() <= 0:
        raise ValueError(f"walk.metric is not {system.n_z + 2} positive numbers")
    objection = problem.objection(parameter, last.origin)
    if objection is not None:
        raise ValueError(f"walk.origin: {objection}")
    arcs = (
        MeshArc(phase=phase, mode=cycle.phases[phase], segment=segment, start=start, end=end, intervals=intervals)
        for phase, segment, start, end, intervals in last.arcs
    )
    equations = transcribe(system, Mesh(cycle=cycle, arcs=tuple(arcs)), (parameter,))
    p = dynamics.at({parameter: last.origin}).p
    curve = Curve(problem, parameter, equations, p, Metric.from_array(last.metric))
    earlier = (before[-1].unknowns, before[-1].direction) if before else None
    point = curve.point(Solution(equations, last.unknowns, p), last.direction, iterations, earlier)
    if not point.at.size < SOLVED:
        raise ValueError("walk.unknowns are not a gait with these phases")
    if not point.in_order:
        raise ValueError("walk.arcs do not match the segments of the control")
    return point
