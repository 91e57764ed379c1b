"""Direct collocation of one step whose torques, or whose motion alone, are unknown.

On each interval of length h the states are polynomials through z_0 and z_1 .. z_d at the Radau points c_j, with

    sum_k C_kj z_k = h f(t_j, z_j, u_j, p),      t_j = t_0 + c_j h,      j = 1 .. d;      z_d starts the next interval

Unknowns are the states at all points, durations of the phases, torque values of an ``open_loop`` law, freed parameters,
and every integral, extremum and length that objective and constraints name. The intervals of the law divide the period,
so that all times are affine in the durations. For multipliers, the duration T of the law is an unknown of its own, and
a row says that it is the period: with T fixed, the other equations are those under a law that is fixed in time.

Margins of the modes and path constraints hold at all points, and ``Collocation.violated`` finds places between them
where they do not: an exchange method of semi-infinite programs (Hettich & Kortanek 1993).

References
----------
L. T. Biegler (2010), Nonlinear Programming, ch. 10.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from casadi import (
    DM,
    MX,
    SX,
    Function,
    Sparsity,
    collocation_coeff,
    collocation_points,
    cse,
    dot,
    jacobian,
    mtimes,
    pi,
    sin,
    sqrt,
    sum1,
    triu,
    vertcat,
)
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array, csc_array

from gaitopt.arrays import Array
from gaitopt.building import building, built_once
from gaitopt.callbacks import Stop, Valued
from gaitopt.gait.gait import Cause, Status
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.open_loop import OpenLoop, Order
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import margin
from gaitopt.model.units import SI
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import ANGLE, CLEARANCE, SCALARS, state_unit, unit_of
from gaitopt.problem.statement import Range
from gaitopt.solver.diagnosis import vanishing_phase
from gaitopt.solver.elements import AssembledProgram, Elements, assembled
from gaitopt.solver.ipopt import Block, Ipopt, IpoptResult, Program
from gaitopt.solver.mesh import mesh_of
from gaitopt.solver.newton import Solution
from gaitopt.solver.rollout import transit_time
from gaitopt.solver.shooting import Label, transcribe

TOLERANCE = 1e-9
"""Of IPOPT."""
MAX_ITERATIONS = 200
NEARBY: dict[str, Any] = {"mu_init": 1e-3, "warm_start_init_point": "yes"} | {
    f"warm_start_{what}": 1e-7
    for what in ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")
}
"""IPOPT stays near the start of a search whose solution and multipliers are close."""
CLOSE: dict[str, Any] = {"mu_init": 1e-4, "bound_mult_init_method": "mu-based"} | dict.fromkeys(
    ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac"), 1e-7
)
"""It stays near a start that is close to a solution, whose multipliers are not known."""
OBJECTIVE_SLOPE, LONGER = 10.0, 5
"""Of searches with bounds on |power|: slope to which the objective is scaled, because absolute work is small next to
powers, and factor of the number of iterations, of which they take some 400."""
DEGREE = 5
"""Radau points of an interval; the states at its end are then of order 9."""
INTERVALS = 20
"""Fewest intervals of a step."""
SHORTEST_PHASE = 1e-3
"""Shortest phase in periods of the guess."""
LONGEST_PERIOD = 5.0
"""Longest period, in those of the guess."""
SMOOTHING = 3e-5
"""Width of the smoothed |power| [W], relative to the walker's weight times 1 m/s."""
ROOM = 1e-7
"""Distance of margins from zero, in natural units: above the error of the collocation, below all that is measured."""
EVENT, DURATION = "event", "duration of the law"
POWER = "absolute_power"
STRUCTURAL = ("integral", "defect", "interpolation", "lengths", "reset", "unused", EVENT, DURATION, POWER)
"""Rows that define a motion rather than limit it."""
MOTION = ("defect", "interpolation", "reset")
"""Those that compare states, all coordinates in turn."""
RATES = {"power": "work", "absolute_power": "work", "squared_torque": "torque_squared"}
"""Scalars with the units of the integrals."""
LENGTHS = ("m", "m", "J")
"""Units of distance, slip, and the work of the push."""
SAMPLES = 12
"""Points per interval at which margins are examined between the collocation points."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """One interval: its phase, the interval of the law, and start and end, affine in the durations and T.

    The coefficients of (1, durations, T) have the shape (n_phases + 2,).
    """

    phase: int
    segment: int
    start: Array
    end: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """A point at which margins hold; ``dynamic`` if it is a collocation point.

    Attributes
    ----------
    interval, fraction : where it is.
    state : index of its state among those of all points.
    """

    interval: int
    fraction: float
    state: int
    dynamic: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Goals:
    """What objective and constraints of a problem name, sorted by how they are stated.

    Attributes
    ----------
    objective : weights by name.
    ranges : of scalars, states, freed parameters and path quantities by name.
    """

    objective: Mapping[str, float]
    ranges: Mapping[str, Range]

    @property
    def names(self) -> tuple[str, ...]:
        """All names, once each."""
        return tuple(dict.fromkeys((*self.objective, *self.ranges)))

    @property
    def extrema(self) -> tuple[str, ...]:
        """Scalars that are extrema."""
        return tuple(name for name in self.names if name in SCALARS and SCALARS[name].extremum)

    @property
    def formulas(self) -> tuple[str, ...]:
        """Scalars that have a formula."""
        return tuple(name for name in self.names if name in SCALARS and SCALARS[name].formula)

    @property
    def bounds_power(self) -> bool:
        """Whether bounds on |power|, which are unknowns, replace it: less absolute work is better, or only limited."""
        name = "absolute_cost_of_transport"
        kept = name not in self.ranges or np.isinf(self.ranges[name].minimum)
        return name in self.names and self.objective.get(name, 0.0) >= 0 and kept

    @property
    def paths(self) -> tuple[str, ...]:
        """Quantities that have a range along the whole step."""
        return tuple(name for name in self.ranges if name == CLEARANCE or name.startswith(ANGLE))


def affine(durations: Array) -> Array:
    """What times are linear in: (1, durations, T), where T is the sum of the durations; shape (n_phases + 2,)."""
    return np.concatenate([[1.0], durations, [durations.sum()]])


Motion: TypeAlias = Callable[[int, Array], Array]
"""A motion: states (n, n_z) in a phase at times (n,) since the impact."""


def straight_motion(problem: Problem, dynamics: Dynamics) -> tuple[Motion, Array]:
    """The straight motion between the postures of a guess, and the durations of its phases.

    Without postures it leads from the guessed posture just after the impact to the one just before the next.
    """
    guess, system, cycle = problem.guess, dynamics.system, problem.cycle
    state = np.array([guess.state[name] for name in system.state_names])
    n, m, first = len(system.walker.shape), len(cycle.phases), guess.first
    period = sum(guess.durations) if guess.durations else transit_time(dynamics, cycle, state)
    durations = np.array(guess.durations if guess.durations else [period / m] * m, dtype=float)
    if first is not None and first.postures:
        shapes = np.array([[posture[name] for name in system.walker.shape] for posture in first.postures])
    else:
        struck, last = system.walker.swapped(cycle.impact), cycle.phases[-1]
        mapped = dynamics.after_impact(struck, state, last)[:n]
        A = np.asarray(system.reset_jacobian(struck, last)(state, dynamics.p))[:n, :n]
        shapes = np.array([state[:n], state[:n] + np.linalg.solve(A, state[:n] - mapped)])
    grid = np.linspace(0.0, period, len(shapes))

    def motion(phase: int, times: Array) -> Array:
        states = np.tile(state, (times.size, 1))
        pieces = np.clip(np.searchsorted(grid, times, side="right") - 1, 0, len(shapes) - 2)
        rates = np.diff(shapes, axis=0) / np.diff(grid)[:, None]
        states[:, :n] = shapes[pieces] + (times - grid[pieces])[:, None] * rates[pieces]
        states[:, system.n_shape + 1 : system.n_shape + 1 + n] = rates[pieces]
        states[:, -1] = cycle.phases[phase].direction * np.abs(states[:, -1])
        return states

    return motion, durations


def first_gait(
    problem: Problem, dynamics: Dynamics, *, progress: Valued = None, should_stop: Stop = None
) -> tuple[Solution | None, IpoptResult, Sequence[Cause]]:
    """A motion of a problem without a known one, under its control law: the solution, if any, and why there is none."""
    motion, durations = straight_motion(problem, dynamics)
    plain = replace(problem, objective={}, constraints={}, free={})
    collocation = Collocation(plain, dynamics.system, durations, free={})
    result = collocation.solve(motion, np.zeros(0), durations, [], progress=progress, should_stop=should_stop)
    if result.status is Status.CONVERGED:
        return collocation.on_mesh(result.w, dynamics), result, ()
    return None, result, collocation.worst(result.w)


class _Rows:
    """The rows of g while they are collected: bounds, names, and entries of the linear part."""

    def __init__(self) -> None:
        self.lower, self.upper, self.names = list[float](), list[float](), list[str]()
        self.at, self.places = Label(name=""), list[Label]()  # where the next rows are, and where all are
        self._entries = list[tuple[Array, ...]]()

    def new(self, count: int, name: str, low: float = 0.0, high: float = 0.0) -> list[int]:
        """The numbers of more rows."""
        first = len(self.lower)
        self.lower += [low] * count
        self.upper += [high] * count
        self.names += [name] * count
        self.places += [self.at] * count
        return [*range(first, first + count)]

    def linear(self, rows: ArrayLike, columns: ArrayLike, values: ArrayLike) -> None:
        """Add entries of the linear part, whose rows, columns and values are broadcast to one shape."""
        self._entries.append(np.broadcast_arrays(rows, columns, values))

    def matrix(self, n_x: int) -> csc_array:
        """The linear part."""
        rows, columns, values = (
            np.concatenate([entry.ravel() for entry in each]) for each in zip(*self._entries, strict=True)
        )
        return csc_array(coo_array((values, (rows, columns)), shape=(len(self.lower), n_x)))


class _Symbols:
    """The quantities of formulas as symbols; integrals that are asked for are collected."""

    def __init__(self, durations: SX, distance: SX, slip: SX, weight: SX, push: SX, incline: SX) -> None:
        self.duration, self.distance, self.slip, self.incline = sum1(durations), distance, slip, incline
        self.weight, self.transport, self.push_work = weight, weight * distance, push
        self.integrals: dict[str, SX] = {}

    def integral(self, rate: str) -> SX:
        """The symbol of an integral."""
        return self.integrals.setdefault(rate, SX.sym(rate))


def rates_of(formulas: Sequence[str]) -> tuple[str, ...]:
    """The integrals that the formulas of some scalars contain."""
    symbols = _Symbols(*(SX.sym(name) for name in ("d", "distance", "slip", "weight", "push", "incline")))
    for name in formulas:
        formula = SCALARS[name].formula
        assert formula is not None
        formula(symbols)
    return tuple(symbols.integrals)


@dataclass(frozen=True, slots=True)
class _Key:
    """What determines the function of a point."""

    system: HybridSystem
    mode: Mode
    n_phases: int
    free: tuple[str, ...]
    goals: tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]
    dynamic: bool
    timed: bool
    bounds_power: bool


@built_once(maxsize=64)
def _point(key: _Key) -> Function:
    """(y, c, p) -> (0, g) of a point, with y = (z, torque values, bounds of |power|, durations, T, freed, extrema).

    c = (start of the time and of h, each affine in the durations and T; interval of the law; weight; clearance; data)
    and g = (-h dz/dt if dynamic, margins, path quantities, extrema, |power| below its bounds, -weight h rates).
    """
    system, mode = key.system, key.mode
    extrema, paths, rates = key.goals
    law, n, m = system.control, system.n_z, key.n_phases
    open_loop = isinstance(law, OpenLoop)
    motors = [*law.values] if isinstance(law, OpenLoop) else []
    ends = 2 if isinstance(law, OpenLoop) and law.order is Order.LINEAR else 1
    z, values = SX.sym("z", n), SX.sym("values", len(motors) * ends)
    d, v, e = SX.sym("d", m), SX.sym("v", len(key.free)), SX.sym("e", len(extrema))
    duration, most = SX.sym("T", int(key.timed)), SX.sym("P", len(system.walker.actuators) if key.bounds_power else 0)
    y, T = vertcat(z, values, most, d, duration, v, e), duration if key.timed else sum1(d)
    data = SX.sym("r", 0 if open_loop else system.n_r)
    time, length = SX.sym("time", m + 2), SX.sym("h", m + 2)
    segment, weight, arch = SX.sym("segment"), SX.sym("weight"), SX.sym("arch")
    c = vertcat(time, length, segment, weight, arch, data)
    p = SX.sym("p", len(system.parameters))
    at = vertcat(1, d, T)
    t, h = dot(time, at), dot(length, at)
    known = dict(zip(key.free, [v[k] for k in range(len(key.free))], strict=True))
    since, r = t, data
    if isinstance(law, OpenLoop):  # the first interval of a law of unit intervals stands for all
        known |= {f"control.{name}.{k}": SX(0) for name in motors for k in range(law.count)}
        known |= {f"control.{name}.{k}": values[ends * j + k] for j, name in enumerate(motors) for k in range(ends)}
        since, r = law.intervals * t / T - segment, SX(law.model_copy(update={"duration": None}).data(0))
    full = vertcat(*(known.get(name, p[k]) for k, name in enumerate(system.parameters)))
    dz, margins = system.flow(mode)(since, z, full, r), system.margins(mode)(since, z, full, r)
    force, torque, power, foot, *_ = system.observation(mode)(since, z, full, r)
    rows = [-h * dz] if key.dynamic else []
    rows.append(margins)
    for name in paths:
        angle = None if name == CLEARANCE else system.angle_names.index(name.removeprefix(ANGLE))
        rows.append(foot[1] - arch * sin(pi * t / sum1(d)) if angle is None else system.angles(z, full)[0][angle])
    for k, name in enumerate(extrema):
        match name:
            case "peak_torque":
                rows += [e[k] - torque, e[k] + torque]
            case "required_friction" if mode.sticks:
                rows += [e[k] * force[1] - force[0], e[k] * force[1] + force[0]]
            case "min_normal_force":
                rows += [force[1] - e[k]]
    width = SMOOTHING * system.weight(full)
    if key.bounds_power:
        rows += [most - power, most + power]
    if key.dynamic:
        by_rate = {
            "power": sum1(power),
            POWER: sum1(most) if key.bounds_power else sum1(sqrt(power**2 + width**2)),
            "squared_torque": sum1(torque**2),
        }
        rows += [-weight * h * by_rate[rate] for rate in rates]
    return Function("point", [y, c, p], cse([SX(0), vertcat(*rows)]))


class Collocation:
    """The program of one step on one mesh.

    Parameters
    ----------
    problem : goals and bounds; the modes are those of one step.
    system : of its walker and law.
    durations : of the phases, from which the order of switches and breakpoints is taken, shape (n_phases,).
    degree, intervals : of the collocation.
    places : (interval, fraction) at which margins hold besides the collocation points.
    timed : the duration of the law is an unknown of its own, which ``motion`` needs.
    """

    @building
    def __init__(
        self,
        problem: Problem,
        system: HybridSystem,
        durations: Array,
        *,
        free: Mapping[str, tuple[float, float]],
        degree: int = DEGREE,
        intervals: int = INTERVALS,
        places: tuple[tuple[int, float], ...] = (),
        timed: bool = False,
    ) -> None:
        self.timed = timed
        self.problem, self.system, self.cycle = problem, system, problem.cycle
        self.goals = Goals(objective=problem.objective, ranges=problem.constraints)
        self.free = free
        self._guess, self._degree, self._count, self.places = durations, degree, intervals, places
        self.dynamics = Dynamics.of(system, problem.parameters)
        law = system.control
        self.law = law if isinstance(law, OpenLoop) else None
        self.mesh = self._intervals(durations)
        self._layout()
        self.program = self._assembled()

    # ---- the mesh

    def _intervals(self, durations: Array) -> list[Interval]:
        """The intervals in the order of these durations."""
        m, period = len(self.cycle.phases), float(durations.sum())
        axes = np.hstack([np.zeros((m, 1)), np.tril(np.ones((m, m))), np.zeros((m, 1))])  # ends of the phases
        cuts = [(row, phase + 1) for phase, row in enumerate(axes)]
        if self.law is not None:
            n = self.law.intervals
            whole = np.array([0.0] * (m + 1) + [1.0] if self.timed else [0.0] + [1.0] * m + [0.0])
            grid = [whole * k / n for k in range(1, n)]
        else:
            grid = [np.append(b, np.zeros(m + 1)) for b in self.system.control.breakpoints if b < period]
        marks: list[tuple[Array, int | None, int | None]] = [(np.zeros(m + 2), 0, 0)]
        marks += [(row, phase, None) for row, phase in cuts]
        marks += [(row, None, k + 1) for k, row in enumerate(grid)]
        at = affine(durations)
        marks.sort(key=lambda mark: float(mark[0] @ at))
        finer = int(np.ceil(self._count / max(1, len(marks) - 1)))
        result, phase, segment = list[Interval](), 0, 0
        for (start, new_phase, new_segment), (end, _, _) in pairwise(marks):
            phase = phase if new_phase is None else new_phase
            segment = segment if new_segment is None else new_segment
            if phase >= m or float((end - start) @ at) <= 0:
                continue
            for k in range(finer):
                begin, finish = (start + (end - start) * (k + j) / finer for j in (0, 1))
                result.append(Interval(phase=phase, segment=segment, start=begin, end=finish))
        return result

    # ---- unknowns

    def _layout(self) -> None:
        """Numbers of the unknowns."""
        system, d = self.system, self._degree
        self._tau = np.append(0.0, collocation_points(d, "radau"))
        C, _, B = collocation_coeff(list(self._tau[1:]))
        self._C, self._B = np.array(C), np.array(B).ravel()
        resets = {phase for phase, _ in self.cycle.resets}
        states, self.points, self._first = 0, list[Point](), list[int]()
        self.phase_starts, self.phase_ends = dict[int, int](), dict[int, int]()
        for k, interval in enumerate(self.mesh):
            before = self.mesh[k - 1].phase if k else None
            if before is None or (before != interval.phase and before in resets):
                states += 1  # a state of its own, after an impact
            self._first.append(states - 1)
            self.phase_starts.setdefault(interval.phase, states - 1)
            jumps = self.law is None or self.law.order is Order.CONSTANT
            if before != interval.phase or (jumps and self.mesh[k - 1].segment != interval.segment):
                self.points.append(Point(interval=k, fraction=0.0, state=states - 1, dynamic=False))
            for j in range(1, d + 1):
                self.points.append(Point(interval=k, fraction=float(self._tau[j]), state=states, dynamic=True))
                states += 1
            self.phase_ends[interval.phase] = states - 1
        for k, fraction in self.places:
            self.points.append(Point(interval=k, fraction=fraction, state=states, dynamic=False))
            states += 1
        self.n_states, n, m = states, system.n_z, len(self.cycle.phases)
        rates = rates_of(self.goals.formulas)
        sizes = {
            "states": n * states,
            "values": 0 if self.law is None else len(self.law.values) * self.law.count,
            "durations": m,
            "law_duration": int(self.timed),
            "freed": len(self.free),
            "extrema": len(self.goals.extrema),
            "integrals": len(rates),
            "lengths": 3,  # distance, slip, work of the push
            "powers": self._n_powers * sum(pt.dynamic for pt in self.points),
        }
        ends = np.cumsum([0, *sizes.values()])
        self.slices = {name: slice(a, b) for name, a, b in zip(sizes, ends, ends[1:], strict=False)}
        self.n_x = int(ends[-1])
        self._rates = rates

    def columns(self, name: str) -> NDArray[np.intp]:
        """Numbers of the unknowns of a block."""
        return np.arange(self.slices[name].start, self.slices[name].stop)

    @property
    def motion(self) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """Unknowns of the motion, as many rows that define it, and those of the last impact, under a law in time."""
        states = np.arange(self.system.n_z * (self.n_states - len(self.places)))
        defining = [name in ("defect", "reset", EVENT) for name in self.row_names]
        closing = [name == "reset" and at.phase == 0 for name, at in zip(self.row_names, self.row_places, strict=True)]
        return np.append(states, self.columns("durations")), np.flatnonzero(defining), np.flatnonzero(closing)

    def _value_columns(self, segment: int) -> list[int]:
        """Torque values at both ends of an interval of the law, motor by motor."""
        if self.law is None:
            return []
        ends = 2 if self.law.order is Order.LINEAR else 1
        first = self.slices["values"].start
        return [first + j * self.law.count + segment + k for j in range(len(self.law.values)) for k in range(ends)]

    @property
    def _n_powers(self) -> int:
        """Bounds of |power| at a collocation point."""
        return len(self.system.walker.actuators) if self.goals.bounds_power else 0

    def _state_columns(self, state: int) -> list[int]:
        n = self.system.n_z
        return [*range(n * state, n * state + n)]

    # ---- the program

    def _assembled(self) -> AssembledProgram:
        """The rows of all points, impacts and scalars."""
        rows = _Rows()
        integrals = rows.new(len(self._rates), "integral")
        rows.linear(integrals, self.columns("integrals"), 1.0)
        lengths = rows.new(3, "lengths")
        rows.linear(lengths, self.columns("lengths"), 1.0)
        elements = [
            self._points_of(rows, integrals, mode, dynamic) for mode in self._modes for dynamic in (True, False)
        ]
        elements += [self._impact_element(rows, lengths, phase, impact) for phase, impact in self.cycle.resets]
        elements.append(self._scalar_element(rows))
        n, x = self.system.n_z, self.system.n_shape
        for phase, mode in enumerate(self.cycle.phases):
            if mode.slips:  # path of the sliding foot
                for state, sign in ((self.phase_ends[phase], -1.0), (self.phase_starts[phase], 1.0)):
                    rows.linear(lengths[1], n * state + x, sign * mode.direction)
        for name, span in self.goals.ranges.items():
            own = self._column_of(name)
            if own is not None:
                rows.linear(rows.new(1, name, span.minimum, span.maximum)[0], own, 1.0)
        if self.timed:
            period = rows.new(1, DURATION)
            rows.linear(period, self.columns("durations"), 1.0)
            rows.linear(period, self.columns("law_duration"), -1.0)
        self._rate_rows(rows)
        self.lbg, self.ubg, self.row_names = np.array(rows.lower), np.array(rows.upper), tuple(rows.names)
        self.row_places = rows.places
        return assembled([each for each in elements if each is not None], rows.matrix(self.n_x), len(self.dynamics.p))

    @building
    def add_rows(self, name: str, rows: Function, curvature: Function, columns: NDArray[np.intp]) -> None:
        """Add rows that must not be negative, all with one name; their functions are kept with the program.

        Parameters
        ----------
        rows : (x, p) -> rows, with a Jacobian.
        curvature : (x, p, multipliers of the rows) -> Hessian in some unknowns, symmetric.
        columns : these unknowns, ascending.
        """
        plain, count, n = self.program, rows.numel_out(0), columns.size
        self._added = rows, curvature  # callbacks of Python must outlive the program
        self.lbg, self.ubg = np.append(self.lbg, np.zeros(count)), np.append(self.ubg, np.full(count, np.inf))
        self.row_names = (*self.row_names, *[name] * count)
        self.row_places = [*self.row_places, *[Label(name="")] * count]
        x, p, weight, multipliers = plain.x, plain.p, MX.sym("w"), MX.sym("l", self.lbg.size)
        g, slope = plain.derivatives["jac_g"](x, p)
        added = rows(x, p)
        chosen = DM(Sparsity.triplet(self.n_x, n, columns.tolist(), [*range(n)]), 1.0)
        bent = mtimes([chosen, curvature(x, p, multipliers[-count:]), chosen.T])
        lagrangian = plain.derivatives["hess_lag"](x, p, weight, multipliers[:-count]) + triu(bent)
        derivatives = {
            "jac_g": ([x, p], [vertcat(g, added), vertcat(slope, jacobian(added, x))], ["g", "jac_g_x"]),
            "hess_lag": ([x, p, weight, multipliers], [lagrangian], ["triu_hess_gamma_x_x"]),
        }
        self.program = replace(
            plain,
            g=vertcat(plain.g, added),
            derivatives=plain.derivatives
            | {
                key: Function(key, inputs, outputs, ["x", "p", "lam_f", "lam_g"][: len(inputs)], names)
                for key, (inputs, outputs, names) in derivatives.items()
            },
        )

    @property
    def _modes(self) -> tuple[Mode, ...]:
        """The modes of the step, once each."""
        return tuple(dict.fromkeys(self.cycle.phases))

    @property
    def _tail(self) -> list[int]:
        """Unknowns of which every point is a function."""
        return [k for name in ("durations", "law_duration", "freed", "extrema") for k in self.columns(name).tolist()]

    @property
    def _arch(self) -> float:
        """Least height of the swing foot in the middle of the step [m]."""
        return self.goals.ranges[CLEARANCE].minimum if CLEARANCE in self.goals.ranges else 0.0

    def _point_function(self, mode: Mode, *, dynamic: bool) -> Function:
        goals, bounds_power = (self.goals.extrema, self.goals.paths, self._rates), dynamic and self._n_powers > 0
        phases, free = len(self.cycle.phases), tuple(self.free)
        return _point(_Key(self.system, mode, phases, free, goals, dynamic, self.timed, bounds_power))

    def _points_of(self, rows: "_Rows", integrals: list[int], mode: Mode, dynamic: bool) -> Elements | None:
        """The points of a mode that are collocation points, or the others."""
        goals, n, names = self.goals, self.system.n_z, self.system.transitions.margin_names(mode)
        units, weights = self.dynamics.margin_units(mode), np.append(0.0, self._B)
        constants, columns, places = list[Array](), list[list[int]](), list[list[int]]()
        n_powers = self._n_powers if dynamic else 0
        for pt in self.points:
            interval = self.mesh[pt.interval]
            if pt.dynamic is not dynamic or self.cycle.phases[interval.phase] is not mode:
                continue
            h, j = interval.end - interval.start, int(np.argmin(np.abs(self._tau - pt.fraction)))
            weight = weights[j] if dynamic else 0.0
            t, data = interval.start + pt.fraction * h, self._data(interval.segment)
            constants.append(np.concatenate([t, h, [interval.segment, weight, self._arch], data]))
            of_point = self._state_columns(pt.state) + self._value_columns(interval.segment)
            if n_powers:
                first = self.slices["powers"].start + n_powers * (pt.interval * self._degree + j - 1)
                of_point += range(first, first + n_powers)
            columns.append(of_point + self._tail)
            rows.at = Label(name="", mode=mode, phase=interval.phase, node=pt.state)
            own = rows.new(n, "defect") if dynamic else list[int]()
            states = [self._first[pt.interval], *range(inner := self._inner(pt.interval), inner + self._degree)]
            if dynamic:
                self._combined(rows, own, states, self._C[:, j - 1])
            elif pt.fraction > 0.0:  # an interpolated state
                interpolated = rows.new(n, "interpolation")
                self._combined(rows, interpolated, [pt.state, *states], np.append(1.0, -self._basis(pt.fraction)))
            for name, unit in zip(names, units.tolist(), strict=True):
                low, high = self._margin_bounds(name, pt, unit)
                own += rows.new(1, EVENT if low == high else name, low, high)
            for name in goals.paths:
                low, high = goals.ranges[name].minimum, goals.ranges[name].maximum
                if name == CLEARANCE:
                    on_ground = pt.state in (self.phase_starts[0], self.phase_ends[len(self.cycle.phases) - 1])
                    low, high = (-np.inf if on_ground else 0.0), np.inf
                own += rows.new(1, name, low, high)
            for name in goals.extrema:
                count = {"peak_torque": 2 * len(self.system.walker.actuators), "min_normal_force": 1}.get(name, 0)
                own += rows.new(2 if name == "required_friction" and mode.sticks else count, name, 0.0, np.inf)
            own += rows.new(2 * n_powers, POWER, 0.0, np.inf)
            places.append(own + (integrals if dynamic else []))
        rows.at = Label(name="")
        if not places:
            return None
        function = self._point_function(mode, dynamic=dynamic)
        return Elements(
            function=function, columns=np.array(columns), rows=np.array(places), constants=np.array(constants)
        )

    def _combined(self, rows: "_Rows", own: list[int], states: Sequence[int], weights: Array) -> None:
        """Add a weighted sum of states to ``own`` rows."""
        n = self.system.n_z
        rows.linear(own, n * np.array(states)[:, None] + np.arange(n), weights[:, None])

    def _impact_element(self, rows: "_Rows", lengths: list[int], phase: int, impact: Mode) -> Elements:
        """An impact: the state after it, the lengths of the step, and its margins."""
        system, ratio = self.system, "impulse_ratio" in self.goals.extrema
        after = (phase + 1) % len(self.cycle.phases)
        rows.at = Label(name="", mode=impact, phase=after, node=self.phase_starts[after])
        own = rows.new(system.n_z, "reset")
        self._combined(rows, own, [self.phase_starts[after]], np.ones(1))
        rows.at = Label(name="", mode=impact)
        own += rows.new(2, "unused", -np.inf, np.inf) if impact.locked else [lengths[0], lengths[2]]
        struck, before = system.transitions.struck(self.cycle, phase), self.cycle.phases[phase]
        assert struck is not None
        for name in system.transitions.impact_margin_names(struck, before):
            own += rows.new(1, name, 0.0, np.inf)
        columns = [*self._state_columns(self.phase_ends[phase]), *self.columns("freed").tolist()]
        if ratio:
            own += rows.new(2, "impulse_ratio", 0.0, np.inf)
            columns.append(self.slices["extrema"].start + self.goals.extrema.index("impulse_ratio"))
        rows.at = Label(name="")
        ends_step = self.cycle.after(phase) is None
        function = _impact(system, (struck, before), ends_step, tuple(self.free), ratio)
        return Elements(
            function=function, columns=np.array([columns]), rows=np.array([own]), constants=np.zeros((1, 0))
        )

    def _scalar_element(self, rows: "_Rows") -> Elements:
        """The objective, and the scalars that have formulas."""
        goals, own = self.goals, list[int]()
        for name in goals.formulas:
            span = goals.ranges.get(name, Range(minimum=-np.inf, maximum=np.inf))
            own += rows.new(1, name, span.minimum, span.maximum)
        blocks = ("durations", "freed", "integrals", "lengths", "extrema")
        states = [name for name in goals.objective if name not in SCALARS and name not in self.free]
        direct = [column for column in map(self._column_of, states) if column is not None]
        columns = np.concatenate([*(self.columns(name) for name in blocks), np.array(direct, dtype=np.intp)])
        function = _scalars(
            self.system,
            len(self.cycle.phases),
            tuple(self.free),
            goals.formulas,
            goals.extrema,
            tuple(goals.objective.items()),
            self._rates,
            tuple(states),
        )
        return Elements(
            function=function,
            columns=columns[None, :],
            rows=np.array(own, dtype=np.intp).reshape(1, -1),
            constants=np.zeros((1, 0)),
        )

    def _rate_rows(self, rows: "_Rows") -> None:
        """|c_(k+1) - c_k| <= rate T / N."""
        law = self.law
        if law is None:
            return
        for name, rate in law.rates.items():
            for k in range(law.intervals):
                first = self.slices["values"].start + [*law.values].index(name) * law.count + k
                for row, sign in zip(rows.new(2, f"control.rates.{name}", 0.0, np.inf), (1.0, -1.0), strict=True):
                    rows.linear(row, [first, first + 1], [sign, -sign])
                    rows.linear(row, self.columns("durations"), rate / law.intervals)

    def _column_of(self, name: str) -> int | None:
        """The unknown that a name means, None if it is none."""
        if name.startswith("state."):
            return self.system.state_names.index(name.removeprefix("state."))
        if name in self.free:
            return int(self.columns("freed")[[*self.free].index(name)])
        if self.law is not None and name.startswith("control."):
            _, motor, k = name.split(".")
            return self.slices["values"].start + [*self.law.values].index(motor) * self.law.count + int(k)
        return None

    def _inner(self, interval: int) -> int:
        """The state at the first collocation point of an interval."""
        return next(pt.state for pt in self.points if pt.interval == interval and pt.dynamic)

    def _data(self, segment: int) -> Array:
        """Segment data of a law that is known."""
        return np.zeros(0) if self.law else self.system.data(segment)

    def _basis(self, fraction: float) -> Array:
        """Values of the Lagrange polynomials of an interval at a fraction of it, shape (d + 1,)."""
        tau = self._tau
        return np.array([np.prod([(fraction - b) / (a - b) for b in tau if b != a]) for a in tau])

    def _margin_bounds(self, name: str, pt: Point, unit: float) -> tuple[float, float]:
        """Bounds of a margin at a point."""
        phase, table = self.mesh[pt.interval].phase, self.system.transitions
        ends = pt.state == self.phase_ends[phase]
        starts = pt.state == self.phase_starts[phase] and pt.fraction == 0.0
        if ends:
            ending = table.ending(self.cycle, phase)
            if name == ending.guard:
                return 0.0, 0.0
            if name in ending.zeros:
                return -np.inf, np.inf
        if margin(name).rises:
            return -np.inf, np.inf
        if starts and name == "slip_velocity" and self.cycle.onset_order(phase) > 0:
            return -np.inf, np.inf
        return ROOM * unit, np.inf

    # ---- meanings

    @property
    def x_labels(self) -> tuple[Label, ...]:
        """Meaning of each unknown; a state between two phases belongs to the later one."""
        names = self.system.state_names
        phases = {pt.state: self.mesh[pt.interval].phase for pt in self.points}
        phases |= {state: self.mesh[k].phase for k, state in enumerate(self._first)}
        labels = [
            Label(name=name, mode=self.cycle.phases[phases[state]], phase=phases[state], node=state, unit=unit)
            for state in range(self.n_states)
            for name, unit in zip(names, map(state_unit, names), strict=True)
        ]
        labels += [Label(name=key, unit=unit_of(key, self.system)) for key in self.value_keys]
        labels += [Label(name="duration", mode=m, phase=k, unit="s") for k, m in enumerate(self.cycle.phases)]
        labels += [Label(name=DURATION, unit="s")] * self.timed
        units = {name: unit_of(name, self.system) or SI["one"] for name in (*self.free, *self.goals.extrema)}
        units |= {rate: unit_of(RATES[rate], self.system) for rate in self._rates}
        units |= dict(zip(("distance", "slip", "push_work"), LENGTHS, strict=True))
        labels += [Label(name=name, unit=unit) for name, unit in units.items()]
        points = [pt for pt in self.points if pt.dynamic] if self._n_powers else []
        for pt in points:
            phase = self.mesh[pt.interval].phase
            at = Label(name=POWER, mode=self.cycle.phases[phase], phase=phase, node=pt.state, unit="W")
            labels += [replace(at, coordinate=motor) for motor in self.system.walker.actuators]
        return tuple(labels)

    @property
    def g_labels(self) -> tuple[Label, ...]:
        """Meaning of each row, in the order of the program."""
        names, labels, run = self.system.state_names, list[Label](), 0
        for name, label in zip(self.row_names, self.row_places, strict=True):
            coordinate = ""
            run = run + 1 if labels and name == labels[-1].name else 0
            if name == EVENT:
                name = self.system.transitions.ending(self.cycle, label.phase or 0).guard
            if name in MOTION:
                coordinate = names[run % len(names)]
                unit = state_unit(coordinate)
            elif name == "integral":
                unit = unit_of(RATES[self._rates[run]], self.system)
            elif name == "lengths":
                unit = LENGTHS[run]
            elif name == DURATION:
                unit = "s"
            elif name == POWER:
                unit = "W"
            elif name == CLEARANCE:
                unit = "m"
            elif name.startswith(ANGLE):
                unit = "rad"
            elif name.startswith("control."):
                unit = unit_of(name, self.system)
            elif label.mode is not None and name not in SCALARS and name != "unused":
                unit = SI[margin(name).unit]
            else:
                unit = unit_of(name, self.system) or SI["one"]
            labels.append(replace(label, name=name, coordinate=coordinate, unit=unit))
        return tuple(labels)

    # ---- numbers

    def bounds(self) -> tuple[Array, Array]:
        """Bounds of all unknowns."""
        lower, upper = np.full(self.n_x, -np.inf), np.full(self.n_x, np.inf)
        walker, largest = self.system.walker, np.full(self.system.n_z, np.inf)
        largest[[walker.shape.index(name) for name in walker.shape if name not in walker.lengths]] = (
            walker.largest_angle
        )
        upper[self.slices["states"]] = np.tile(largest, self.n_states)
        lower[self.slices["states"]] = -upper[self.slices["states"]]
        period = float(self._guess.sum())
        durations = self.slices["durations"]
        lower[durations], upper[durations] = SHORTEST_PHASE * period, LONGEST_PERIOD * period
        for k, (low, high) in zip(self.columns("freed"), self.free.values(), strict=True):
            lower[k], upper[k] = low, high
        if self.law is not None:
            spans = [self.law.spans(self.system.walker)[name] for name in self.law.values]
            lower[self.slices["values"]] = np.repeat([low for low, _ in spans], self.law.count)
            upper[self.slices["values"]] = np.repeat([high for _, high in spans], self.law.count)
        for k, name in zip(self.columns("extrema"), self.goals.extrema, strict=True):
            span = self.goals.ranges.get(name)
            if span is not None:
                lower[k], upper[k] = span.minimum, span.maximum
        return lower, upper

    @property
    def blocks(self) -> tuple[Block, Block]:
        """All unknowns, and all rows, with their bounds."""
        lower, upper = self.bounds()
        return (
            Block(name="unknowns", expression=self.program.x, lower=lower, upper=upper),
            Block(name="rows", expression=self.program.g, lower=self.lbg, upper=self.ubg),
        )

    def vanishing(self, x: Array) -> Cause | None:
        """The phase whose duration is at its lower bound, which no gait has; None if there is none."""
        durations, shortest = self.unpack(x)["durations"], SHORTEST_PHASE * float(self._guess.sum())
        phase = int(np.argmin(durations))
        return vanishing_phase(self.cycle, phase, durations[phase]) if durations[phase] < 1.01 * shortest else None

    def point_times(self, durations: Array) -> Array:
        """Times of all states [s]."""
        at, times = affine(durations), np.empty(self.n_states)
        for k, interval in enumerate(self.mesh):
            times[self._first[k]] = interval.start @ at
        for pt in self.points:
            interval = self.mesh[pt.interval]
            times[pt.state] = (interval.start + pt.fraction * (interval.end - interval.start)) @ at
        return times

    def pack(self, states: Array, values: Array, durations: Array, freed: Sequence[float]) -> Array:
        """A start from states (n_states, n_z), values by motor and durations; the rest is zero or one."""
        x = np.zeros(self.n_x)
        x[self.slices["states"]] = states.ravel()
        x[self.slices["values"]] = values
        x[self.slices["durations"]] = durations
        x[self.slices["law_duration"]] = durations.sum()
        x[self.slices["freed"]] = freed
        x[self.slices["extrema"]] = 1.0
        return x

    def solve(
        self,
        motion: Motion,
        values: Array,
        durations: Array,
        freed: Sequence[float],
        *,
        progress: Valued = None,
        should_stop: Stop = None,
        again: "tuple[Collocation, IpoptResult] | None" = None,
        close: bool = False,
        max_iterations: int = MAX_ITERATIONS,
    ) -> IpoptResult:
        """IPOPT's solution from a motion, which is ``close`` to one or not.

        ``again`` is the same program without the last places, and its solution.
        """
        unknowns, rows = self.blocks
        program = Program(
            unknowns=(unknowns,),
            rows=(rows,),
            p=self.program.p,
            f=self.program.f,
            x0=self.start(motion, values, durations, freed),
            p0=self.dynamics.p,
        )
        options: dict[str, Any] = {"tol": TOLERANCE, "max_iter": max_iterations, "bound_relax_factor": 0.0}
        options |= NEARBY if again else CLOSE if close else {}
        if self._n_powers:
            options |= {"nlp_scaling_obj_target_gradient": OBJECTIVE_SLOPE, "max_iter": LONGER * max_iterations}
        ipopt = Ipopt(program, options=options, exact=True, derivatives=self.program.derivatives)
        multipliers = None if again is None else self._extended(*again)
        return ipopt.solve(multipliers=multipliers, progress=progress, should_stop=should_stop)

    def _extended(self, before: "Collocation", result: IpoptResult) -> tuple[Array, Array]:
        """Multipliers of the bounds and the rows: those of a program without the last places, and zero there."""
        n, bounds, rows = self.system.n_z, np.zeros(self.n_x), np.zeros(self.lbg.size)
        kept = np.ones(self.n_x, dtype=bool)
        kept[n * before.n_states : n * self.n_states] = False
        added = np.array([at.node is not None and at.node >= before.n_states for at in self.row_places])
        bounds[kept] = result.bound_multipliers
        rows[np.flatnonzero(~added)[: result.multipliers.size]] = result.multipliers  # rows may have been added
        return bounds, rows

    def on_mesh(self, x: Array, dynamics: Dynamics) -> Solution:
        """The motion of a solution on a mesh of multiple shooting, under the law of ``dynamics``."""
        system, durations = dynamics.system, self.unpack(x)["durations"]
        mesh = mesh_of(self.cycle, durations, system.control.breakpoints)
        nodes = np.empty((system.n_z, mesh.n_nodes))
        for arc, at, (begin, end) in zip(mesh.arcs, mesh.arc_nodes, mesh.arc_times(durations.tolist()), strict=True):
            nodes[:, at.start : at.stop] = self.states_at(x, arc.phase, np.linspace(begin, end, len(at))).T
        equations = transcribe(system, mesh)
        return Solution(equations, equations.pack(nodes, durations), dynamics.p)

    @property
    def value_keys(self) -> tuple[str, ...]:
        """Dotted keys of the torque values."""
        law = self.law
        return () if law is None else tuple(f"control.{name}.{k}" for name in law.values for k in range(law.count))

    def start(self, motion: Motion, values: Array, durations: Array, freed: Sequence[float]) -> Array:
        """A start from a motion, called with a phase and times; integrals and lengths have their values there."""
        times, states = self.point_times(durations), np.empty((self.n_states, self.system.n_z))
        of_phase: dict[int, list[int]] = {}
        for k, interval in enumerate(self.mesh):
            of_phase.setdefault(interval.phase, []).append(self._first[k])
        for pt in self.points:
            of_phase.setdefault(self.mesh[pt.interval].phase, []).append(pt.state)
        for phase, members in of_phase.items():
            states[members] = motion(phase, times[members])
        x = self.pack(states, values, durations, freed)
        rows = Function("rows", [self.program.x, self.program.p], [self.program.g])
        g = np.asarray(rows(x, self.dynamics.p)).ravel()
        names = np.array(self.row_names)
        if self._n_powers:
            x[self.slices["powers"]] = -g[names == POWER].reshape((-1, 2, self._n_powers)).min(axis=1).ravel()
            g = np.asarray(rows(x, self.dynamics.p)).ravel()
        x[self.slices["integrals"]] -= g[names == "integral"]
        x[self.slices["lengths"]] -= g[names == "lengths"]
        for k, name in zip(self.columns("extrema"), self.goals.extrema, strict=True):
            x[k] = self._extremum(name, x)
        return x

    def _extremum(self, name: str, x: Array) -> float:
        """The least value of an extremum that satisfies its rows; they are linear in it."""
        rows = Function("rows", [self.program.x, self.program.p], [self.program.g])
        k = self.slices["extrema"].start + self.goals.extrema.index(name)
        at = np.array(self.row_names) == name
        x0, x1 = x.copy(), x.copy()
        x0[k], x1[k] = 0.0, 1.0
        a, b = (np.asarray(rows(each, self.dynamics.p)).ravel()[at] for each in (x0, x1))
        moves = b != a
        zeros = -a[moves] / (b - a)[moves]
        return float(zeros.max() if SCALARS[name].extremum > 0 else zeros.min())

    def violated(self, x: Array, samples: int, limit: float) -> list[tuple[int, float]]:
        """Places between the points, (interval, fraction), at which a margin or path constraint is violated."""
        blocks, goals, table = self.unpack(x), self.goals, self.system.transitions
        tail = self._tail
        fractions = (np.arange(samples * self._degree) + 0.5) / (samples * self._degree)
        basis = np.array([self._basis(f) for f in fractions])
        found = list[tuple[int, float]]()
        for k, interval in enumerate(self.mesh):
            mode = self.cycle.phases[interval.phase]
            inner = self._inner(k)
            z = basis @ blocks["states"][[self._first[k], *range(inner, inner + self._degree)]]
            h = interval.end - interval.start
            t = interval.start + fractions[:, None] * h
            data = self._data(interval.segment)
            rest = np.concatenate([h, [interval.segment, 0.0, self._arch], data])
            c = np.hstack([t, np.tile(rest, (fractions.size, 1))])
            y = np.hstack(
                [z, np.tile(np.concatenate([x[self._value_columns(interval.segment)], x[tail]]), (fractions.size, 1))]
            )
            values = np.asarray(
                self._point_function(mode, dynamic=False).map(fractions.size, "serial")(y.T, c.T, self.dynamics.p)[1]
            )
            names, units = table.margin_names(mode), self.dynamics.margin_units(mode)
            slack = np.full(fractions.size, np.inf)
            pt = Point(interval=k, fraction=0.5, state=-1, dynamic=False)
            for row, (name, unit) in enumerate(zip(names, units, strict=True)):
                if self._margin_bounds(name, pt, float(unit))[0] > -np.inf:
                    slack = np.minimum(slack, values[row] / unit)
            for row, name in enumerate(goals.paths, start=len(names)):
                span = goals.ranges[name]
                low, high = (0.0, np.inf) if name == CLEARANCE else (span.minimum, span.maximum)
                slack = np.minimum(slack, np.minimum(values[row] - low, high - values[row]) + ROOM)
            extra = values[len(names) + len(goals.paths) :]
            if extra.size:
                slack = np.minimum(slack, extra.min(axis=0) + ROOM)
            lowest = int(np.argmin(slack))
            if slack[lowest] < limit and not any(k == i and abs(f - fractions[lowest]) < 1e-6 for i, f in self.places):
                found.append((k, float(fractions[lowest])))
        return found

    def active(self, multipliers: Array, bound_multipliers: Array) -> list[tuple[str, float]]:
        """Names of rows and bounds with the sizes of their multipliers, relative to the largest, largest first.

        A multiplier times its bound, or the natural unit of a margin, is the effect of a relative change of the bound.
        """
        sums = dict[str, float]()
        limits = np.where(multipliers > 0, self.ubg, self.lbg).tolist()
        for name, at, value, limit in zip(self.row_names, self.row_places, multipliers.tolist(), limits, strict=True):
            if name not in STRUCTURAL:
                unit = abs(limit) / (ROOM if at.mode is not None and name not in self.goals.ranges else 1.0) or 1.0
                sums[name] = sums.get(name, 0.0) + abs(value) * (unit if np.isfinite(unit) else 1.0)
        lower, upper = (each[self.slices["values"]] for each in self.bounds())
        pressed = bound_multipliers[self.slices["values"]]
        ends = np.where(pressed > 0, upper, lower)
        for key, value, end in zip(self.value_keys, pressed.tolist(), ends.tolist(), strict=True):
            motor = key.split(".")[1]
            stated = self.law is not None and motor in self.law.bounds
            name = f"control.bounds.{motor}" if stated else f"the effort of {motor}"
            sums[name] = sums.get(name, 0.0) + abs(value) * (abs(end) if np.isfinite(end) else 0.0)
        for key, value in zip(self.free, bound_multipliers[self.slices["freed"]].tolist(), strict=True):
            sums[key] = abs(value)
        largest = max(sums.values(), default=0.0) or 1.0
        return sorted(((name, value / largest) for name, value in sums.items()), key=lambda each: -each[1])

    def worst(self, x: Array) -> list[Cause]:
        """The limit that is violated most at a point, or the largest residual of the equations of motion."""
        rows = Function("rows", [self.program.x, self.program.p], [self.program.g])
        g = np.asarray(rows(x, self.dynamics.p)).ravel()
        violation = np.maximum(self.lbg - g, g - self.ubg)
        beyond = np.where([name in STRUCTURAL for name in self.row_names], 0.0, violation)
        k = int(np.argmax(beyond if np.max(beyond) > ROOM else violation))
        name, bound = self.row_names[k], float(np.clip(g[k], self.lbg[k], self.ubg[k]))
        if not violation[k] > ROOM:
            return []
        if self.row_places[k].mode is not None and name not in self.goals.ranges:
            bound = 0.0  # without the room for the error of the collocation
        side = "at least" if g[k] < bound else "at most"
        words = f"{name.replace('_', ' ')} is {g[k]:.4g}, must be {side} {bound:.4g}"
        if name in STRUCTURAL:
            words = f"{name} of the equations of motion is off by {violation[k]:.3g}"
        return [Cause(what=name, words=words, needed=bound, available=float(g[k]))]

    def unpack(self, x: Array) -> dict[str, Array]:
        """Blocks of the unknowns by name; states have the shape (n_states, n_z)."""
        blocks = {name: x[at] for name, at in self.slices.items()}
        return {**blocks, "states": blocks["states"].reshape(self.n_states, -1)}

    def states_at(self, x: Array, phase: int, times: Array) -> Array:
        """States of the collocation polynomials in a phase at times since the impact, shape (n, n_z)."""
        blocks = self.unpack(x)
        at, states = affine(blocks["durations"]), blocks["states"]
        mine = [k for k, interval in enumerate(self.mesh) if interval.phase == phase]
        starts = np.array([self.mesh[k].start @ at for k in mine])
        result = []
        for time in times:
            k = mine[max(0, int(np.searchsorted(starts, time, side="right")) - 1)]
            begin, end = self.mesh[k].start @ at, self.mesh[k].end @ at
            inner = self._inner(k)
            nodes = [self._first[k], *range(inner, inner + self._degree)]
            result.append(self._basis((time - begin) / (end - begin)) @ states[nodes])
        return np.array(result)


@built_once(maxsize=32)
def _impact(
    system: HybridSystem, modes: tuple[Mode, Mode], ends_step: bool, free: tuple[str, ...], ratio: bool
) -> Function:
    """(y, c, p) -> (0, (-z_plus, -step length, -work of the push, margins)) of y = (z, freed, impulse ratio).

    Parameters
    ----------
    modes : of the impact, and before it; see ``HybridSystem.reset``.
    """
    z, v, e = SX.sym("z", system.n_z), SX.sym("v", len(free)), SX.sym("e", int(ratio))
    p = SX.sym("p", len(system.parameters))
    full = vertcat(*(v[free.index(name)] if name in free else p[k] for k, name in enumerate(system.parameters)))
    z_plus = system.impact(*modes, ends_step=ends_step)(z=z, p=full)["z_plus"]
    distance, x = z_plus[system.n_shape], system.n_shape
    moved = vertcat(z_plus[:x], 0 if ends_step else z_plus[x], z_plus[x + 1 :])
    push = system.push(z=z, p=full)["work"]
    rows = [-moved, -distance, -push, system.impact_margins(*modes)(z, full)]
    if ratio:
        sticks = modes[0].with_states(dict.fromkeys(modes[0].touching, Mode.STICK))
        impulse = system.impact(sticks, modes[1], ends_step=ends_step)(z=z, p=full)["impulse"]
        rows += [e * impulse[1] - impulse[0], e * impulse[1] + impulse[0]]
    return Function("impact", [vertcat(z, v, e), SX(0, 1), p], cse([SX(0), vertcat(*rows)]))


@built_once(maxsize=32)
def _scalars(
    system: HybridSystem,
    n_phases: int,
    free: tuple[str, ...],
    formulas: tuple[str, ...],
    extrema: tuple[str, ...],
    objective: tuple[tuple[str, float], ...],
    rates: tuple[str, ...],
    states: tuple[str, ...],
) -> Function:
    """(y, c, p) -> (objective, scalars) of y = (durations, freed, integrals, lengths, extrema, states)."""
    d, v = SX.sym("d", n_phases), SX.sym("v", len(free))
    lengths, e, direct = SX.sym("lengths", 3), SX.sym("e", len(extrema)), SX.sym("direct", len(states))
    integrals, p = SX.sym("integrals", len(rates)), SX.sym("p", len(system.parameters))
    full = vertcat(*(v[free.index(name)] if name in free else p[k] for k, name in enumerate(system.parameters)))
    symbols = _Symbols(d, lengths[0], lengths[1], SX(system.weight(full)), lengths[2], SX(system.incline(full)))
    symbols.integrals = {rate: integrals[k] for k, rate in enumerate(rates)}
    values = {name: SCALARS[name].formula(symbols) for name in formulas}  # type: ignore[misc]  # formulas have one
    values |= {name: e[k] for k, name in enumerate(extrema)}
    values |= {name: v[k] for k, name in enumerate(free)} | {name: direct[k] for k, name in enumerate(states)}
    total = sum((weight * values[name] for name, weight in objective), SX(0))
    return Function(
        "scalars",
        [vertcat(d, v, integrals, lengths, e, direct), SX(0, 1), p],
        [total, vertcat(SX(0, 1), *(values[name] for name in formulas))],
    )
