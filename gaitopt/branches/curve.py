"""One branch: the curve of gaits with one mode sequence, evaluated at a point in everything that is watched.

Finding the place between two points of a branch at which something watched is zero.

Gaits that vanish: the feet come down ever closer to each other, until there is no step left.

    stride = distance between the feet at touchdown / length of a leg  ->  0

The durations of phases, the rate of touchdown, and the impulse of the impact vanish with it, in different powers, so
that any of them may be the monitor that is lost first. Close to that point no simulation resolves the step.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.branches.monitors import MonitorKey, MonitorValue, monitor_values
from gaitopt.branches.request import test_functions
from gaitopt.gait.branch import WalkState
from gaitopt.gait.gait import Gait
from gaitopt.iteration import bracketed_root
from gaitopt.model.cycle import Cycle
from gaitopt.model.dynamics import Dynamics
from gaitopt.nlp.arclength import Curve, CurvePoint
from gaitopt.nlp.assembly import assemble_gait
from gaitopt.nlp.layout import ArcLayout, Layout, layout
from gaitopt.nlp.newton import Solution, halved, refine
from gaitopt.nlp.rollout import Rollout, roll_out
from gaitopt.nlp.shooting import MultipleShooting, transcribe
from gaitopt.problem.problem import Problem

SOLVED = 1e-10
"""Violation of an equality in natural units below which stored unknowns are a gait; a walk writes 1e-13 or less."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Metric:
    """What arclength is measured with; the same along a whole family.

    Attributes
    ----------
    state : ndarray, shape (n_z,) - size of every coordinate of the state after impact: its natural unit times the
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
        return Metric(state=unit * float(np.abs(gait.state / unit).max()), period=gait.period, span=span)

    @staticmethod
    def from_array(values: Array) -> "Metric":
        """The metric that ``to_array`` has written."""
        *state, period, span = values.tolist()
        return Metric(state=np.array(state), period=period, span=span)

    def to_array(self) -> Array:
        """Sizes of the state, period and span; shape (n_z + 2,)."""
        return np.array([*self.state, self.period, self.span])

    def scales(self, section: NDArray[np.intp], n_phases: int) -> Array:
        """Of section coordinates, durations and parameter; shape (n_xi + n_phases + 1,)."""
        return np.concatenate([self.state[section], np.full(n_phases, self.period), [self.span]])

    def apart(self, first: Array, second: Array) -> float:
        """Largest distance of two states after impact, in the sizes of the coordinates."""
        return float(np.abs((first - second) / self.state).max())


@dataclass(frozen=True)
class Point:
    """A point of a segment with its gait; monitors and test functions are computed on first use.

    Attributes
    ----------
    curve_point : on the curve of solutions.
    gait : the gait there.
    """

    curve_point: CurvePoint
    gait: Gait

    @property
    def value(self) -> float:
        """The parameter."""
        return float(self.curve_point.at.w[-1])

    @cached_property
    def monitors(self) -> dict[MonitorKey, MonitorValue]:
        """What the mode sequence assumes."""
        return monitor_values(self.gait)

    @cached_property
    def tests(self) -> dict[str, float]:
        """Test functions of special points by name."""
        return test_functions(self.gait.multipliers, float(self.curve_point.tangent[-1]))

    def monitor(self, name: MonitorKey) -> float:
        """Value of one monitor; one that is not read here is far from zero."""
        return self.monitors[name].value if name in self.monitors else np.inf

    def test(self, name: str) -> float:
        """Value of one test function."""
        return self.tests[name]


class Segment:
    """Gaits of one mode sequence along one parameter.

    Parameters
    ----------
    problem : with this sequence.
    parameter : dotted key.
    transcription : with that parameter freed.
    p : ndarray - values of all parameters, that of ``parameter`` being ignored.
    metric : what arclength is measured with.
    """

    def __init__(
        self,
        problem: Problem,
        parameter: str,
        transcription: MultipleShooting,
        p: Array,
        metric: Metric,
    ) -> None:
        self.problem, self.parameter, self.p, self.metric = problem, parameter, p, metric
        self._use(transcription)

    @property
    def cycle(self) -> Cycle:
        """The modes of this segment."""
        return self.transcription.layout.cycle

    def start(self, w: Array, forward: Array) -> Point | None:
        """The gait next to ``w`` at its parameter, on a mesh that is fine enough; its tangent along ``forward``."""
        curve_point = self.curve.start(w, forward)
        if curve_point is None:
            return None
        return self.remeshed(self._point(curve_point))

    def branch_off(self, w: Array, along: Array, length: float) -> Point | None:
        """The gait at distance ``length`` from the branch point ``w`` on the branch that crosses ``along``.

        ``along`` is the tangent of the known branch in scaled coordinates; the sign of ``length`` chooses the half.
        """
        direction = self.curve.crossing(w, along)
        curve_point = None if direction is None else self.curve.branch_off(w, direction, length)
        return None if curve_point is None else self.remeshed(self._point(curve_point))

    def step(self, point: Point, length: float) -> Point | None:
        """The gait at arclength ``length`` from a point."""
        curve_point = self.curve.step(point.curve_point, length)
        return None if curve_point is None else self._point(curve_point)

    def at_parameter(self, point: Point, value: float) -> Point | None:
        """The gait near a point with the given value of the parameter."""
        curve_point = self.curve.at_parameter(point.curve_point, value)
        return None if curve_point is None else self._point(curve_point)

    def remeshed(self, point: Point) -> Point | None:
        """The same gait on a finer mesh where its integration error needs one; None if that fails."""
        refined = refine(point.curve_point.at)
        return point if refined.transcription is self.transcription else self._on(refined, point)

    def solved_again(self, point: Point) -> Point | None:
        """The same gait down to rounding with every interval cut in two; None if that fails."""
        return self._on(halved(point.curve_point.at), point)

    def _on(self, refined: Solution, point: Point) -> Point | None:
        """A point on another mesh, on which the segment goes on."""
        old, at = self.transcription, Solution(refined.transcription, refined.w, refined.p)
        forward = resized(point.curve_point.tangent, old, refined.transcription)
        self._use(refined.transcription)
        curve_point = self.curve.through(at, self.curve.coordinates(forward))
        if curve_point is None:
            self._use(old)
            return None
        return self._point(curve_point)

    def in_order(self, point: Point) -> bool:
        """Whether no switch has passed a breakpoint of the control; a phase that has vanished is another matter."""
        durations = self.transcription.unpack(point.curve_point.at.w).durations
        breakpoints = self.transcription.system.control.breakpoints
        return bool(durations.min() <= 0) or self.transcription.layout.in_order(durations, breakpoints)

    def reordered(self, point: Point) -> "tuple[Segment, Point] | None":
        """The same branch with arcs in the order that a point's durations ask for; no mode has changed."""
        old = self.transcription
        nodes, durations, freed = old.unpack(point.curve_point.at.w)
        dynamics = old.dynamics(self.p, freed)
        rolled = roll_out(dynamics, self.cycle, nodes[:, 0], durations)
        segment, w = segment_through(self.problem, dynamics, self.parameter, self.metric, rolled)
        first = segment.start(w, resized(point.curve_point.tangent, old, segment.transcription))
        return None if first is None or not segment.in_order(first) else (segment, first)

    def coordinates(self, w: Array) -> Array:
        """Scaled section coordinates, durations and parameter, in which arclength is measured."""
        return self.curve.coordinates(w)

    def walk_state(self, point: Point) -> WalkState:
        """What ``resumed`` needs to go on from a point."""
        at, metric, plan = point.curve_point, self.metric, self.transcription.layout
        return WalkState(
            unknowns=at.at.w,
            direction=at.tangent,
            arcs=tuple((arc.phase, int(arc.segment), arc.start, arc.end, arc.intervals) for arc in plan.arcs),
            origin=float(self.p[self.transcription.system.parameters.index(self.parameter)]),
            metric=metric.to_array(),
            earlier=len(at.earlier),
        )

    @staticmethod
    def resumed(
        problem: Problem, dynamics: Dynamics, parameter: str, states: Sequence[WalkState], iterations: int
    ) -> "tuple[Segment, Point]":
        """The segment and its last point from their ``walk_state``, to the last bit.

        Parameters
        ----------
        problem : with the modes of the segment.
        dynamics : at the values of all other parameters.
        states : of the last point, and before it those of the points from which the next one is extrapolated.
        iterations : what Newton's method took to get to the last point.

        Raises
        ------
        ValueError
            If the states do not fit the modes, or the last one is no gait of them.
        """
        *before, last = states
        cycle, system = problem.cycle, dynamics.system
        n_nodes = sum(intervals for *_, intervals in last.arcs) + len(cycle.resets)
        sizes = {state.unknowns.size for state in states} | {state.direction.size for state in states}
        if [*dict.fromkeys(arc[0] for arc in last.arcs)] != list(range(len(cycle.phases))):
            raise ValueError(f"walk.arcs do not cover the {len(cycle.phases)} phases in order")
        if sizes != {n_nodes * system.n_z + len(cycle.phases) + 1}:
            raise ValueError("walk.unknowns or walk.direction do not have the size that walk.arcs ask for")
        if last.metric.size != system.n_z + 2 or last.metric.min() <= 0:
            raise ValueError(f"walk.metric is not {system.n_z + 2} positive numbers")
        objection = problem.objection(parameter, last.origin)
        if objection is not None:
            raise ValueError(f"walk.origin: {objection}")
        arcs = (
            ArcLayout(phase=phase, mode=cycle.phases[phase], segment=segment, start=start, end=end, intervals=intervals)
            for phase, segment, start, end, intervals in last.arcs
        )
        transcription = transcribe(system, Layout(cycle=cycle, arcs=tuple(arcs)), (parameter,))
        p = dynamics.at({parameter: last.origin}).p
        segment = Segment(problem, parameter, transcription, p, Metric.from_array(last.metric))
        earlier = tuple((state.unknowns, state.direction) for state in reversed(before))
        curve_point = segment.curve.point(last.unknowns, last.direction, iterations, earlier)
        if not curve_point.at.size < SOLVED:
            raise ValueError("walk.unknowns are not a gait of these phases")
        point = segment._point(curve_point)
        if not segment.in_order(point):
            raise ValueError("walk.arcs do not keep to the segments of the control")
        return segment, point

    def _use(self, transcription: MultipleShooting) -> None:
        section = transcription.system.section(transcription.layout.cycle.impact)
        scales = self.metric.scales(section, transcription.n_phases)
        self.transcription, self.curve = transcription, Curve(transcription, self.p, scales)

    def assembled(self, w: Array) -> Gait:
        """The gait at ``w`` without Newton's method, which fails at a branch point."""
        return self._gait(Solution(self.transcription, w, self.p), 0)

    def _point(self, curve_point: CurvePoint) -> Point:
        return Point(curve_point=curve_point, gait=self._gait(curve_point.at, curve_point.iterations))

    def _gait(self, at: Solution, iterations: int) -> Gait:
        return assemble_gait(
            self.problem.replace({self.parameter: float(at.w[-1])}),
            at,
            errors=np.zeros(self.transcription.n_phases),
            message="continued",
            solver={"iterations": float(iterations)},
        )


def segment_through(
    problem: Problem,
    dynamics: Dynamics,
    parameter: str,
    metric: Metric,
    rolled: Rollout,
    intervals: Sequence[int] = (),
) -> tuple[Segment, Array]:
    """A branch through a rolled out motion of ``dynamics``, and the unknowns w of that motion."""
    durations = np.array(rolled.durations)
    plan = layout(problem.cycle, durations, dynamics.system.control.breakpoints)
    plan = plan.refined(intervals) if len(intervals) == len(plan.arcs) else plan
    transcription = transcribe(dynamics.system, plan, (parameter,))
    w = transcription.pack(rolled.nodes(plan), durations, (dynamics.parameter(parameter),))
    return Segment(problem, parameter, transcription, dynamics.p, metric), w


def resized(tangent: Array, old: MultipleShooting, new: MultipleShooting) -> Array:
    """A tangent for another mesh, right in those entries that count for arclength; all inner nodes are left zero."""
    n_z = old.system.n_z
    result = np.zeros(new.w.numel())
    result[:n_z] = tangent[:n_z]
    tail = old.n_phases + 1
    result[-tail:] = tangent[-tail:]
    return result


LENGTH_TOLERANCE = 1e-13
"""In arclength; the parameter is then right to more than ten digits of its range."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Location:
    """A place on a step.

    Attributes
    ----------
    length : arclength from the start of the step.
    point : the gait there.
    status : ``converged``, or ``guess`` where Newton's method failed on the way and only the step is known.
    name : the monitor that vanishes, None for a test function.
    """

    length: float
    point: Point
    status: str
    name: MonitorKey | None


class _LostError(Exception):
    """Newton's method did not converge at a trial length."""


def locate(
    segment: Segment,
    before: Point,
    after: Point,
    length: float,
    watched: Callable[[Point], float],
    name: MonitorKey | None = None,
) -> Location:
    """The zero of ``watched`` on the step of the given arclength from ``before`` to ``after``."""
    seen: dict[float, Point] = {0.0: before, length: after}

    def value(at: float) -> float:
        if at not in seen:
            point = segment.step(before, at)
            if point is None:
                raise _LostError
            seen[at] = point
        return watched(seen[at])

    try:
        root = bracketed_root(value, 0.0, length, LENGTH_TOLERANCE)
    except _LostError:
        return Location(length=length, point=after, status="guess", name=name)
    value(root)
    return Location(length=root, point=seen[root], status="converged", name=name)


VANISHED = 1e-4
"""Stride of a gait that is lost together with its step; a mode sequence alone is lost in full stride."""
FADING = 1e-2
"""Stride below which a gait that the simulator does not confirm may be about to vanish."""
REASON = "the gait vanishes: its strides shrink to nothing, both feet come down in the same place"


def stride(gait: Gait) -> float:
    """Largest distance between the feet at a touchdown, in lengths of a leg; slip does not count.

    Infinite for a walker that flies, which may land where it took off.
    """
    if gait.system.walker.flies:
        return np.inf
    x = gait.system.n_shape
    apart = [
        abs(step.impact.step_length - step.arcs[-1].states[-1, x]) for step in gait.steps if step.impact is not None
    ]
    return float(max(apart)) / gait.dynamics.scales.length


def vanishing_value(before: Point, last: Point) -> float:
    """The parameter at which the stride is zero, extrapolated from the last two gaits."""
    first, second = stride(before.gait), stride(last.gait)
    if not second < first:
        return last.value
    return last.value + (last.value - before.value) * second / (first - second)
