"""Optimal open-loop torques: the gait and the torque values c that minimise an objective and meet constraints.

    min over (z, c, T) of f      s.t.   z is the motion of one step under u(t; c, T),  margins >= 0,  lo <= g <= hi

The program of ``solver.collocation`` is solved by IPOPT with exact derivatives, first with margins at the collocation
points. Extra points between them where a margin is violated are added until none is (an exchange method). The torques
are then fixed in time, and the gait under them is solved by multiple shooting like any other. A bound on the spectral
radius is met in steps from the optimum without it (``stability``).
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from casadi import Function

from gaitopt.arrays import Array, overflow_allowed
from gaitopt.callbacks import Stop, Valued
from gaitopt.design.spectral_radius import RADIUS
from gaitopt.design.stability import bound_radius, largest_modulus
from gaitopt.gait.gait import Cause, Gait, Status, best_point
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.open_loop import OpenLoop
from gaitopt.model.system import HybridSystem
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import ANGLE, CLEARANCE
from gaitopt.problem.statement import Range
from gaitopt.solver.collocation import MAX_ITERATIONS, SAMPLES, STRUCTURAL, Collocation, Motion
from gaitopt.solver.collocation_mesh import INTERVALS, ExtraPoints
from gaitopt.solver.collocation_rows import SMALLEST_MARGIN
from gaitopt.solver.first_gait import straight_motion
from gaitopt.solver.ipopt import Block, IpoptResult, what_limits
from gaitopt.solver.program import EXTERNAL, LARGEST_RESIDUAL, NonlinearProgram, checked_gait, failed_gait
from gaitopt.solver.rollout import guessed_motion

MAX_EXCHANGES = 8
"""Largest number of rounds in which instants between the points are added."""
LARGEST_VIOLATION = 1e-6
"""A bound cannot be met if the best value violates it by more than this, relative to the bound or to one."""
VIOLATED_MARGIN = 0.5 * SMALLEST_MARGIN
"""A margin that is smaller than this between the points, in natural units, becomes a row of the program there too."""
SUSPECT_MARGIN = 1e-4
"""A margin that is smaller than this between the points of the first motion, in natural units, is a row from the
beginning, which saves rounds."""
BESIDE = 2
"""Number of samples on either side of a violated margin that become rows too, because the smallest margin moves."""
MESHES = (INTERVALS, 2 * INTERVALS, 4 * INTERVALS)
"""Smallest numbers of intervals, tried in turn: on long intervals fast motions differ from polynomials by more than
``SMALLEST_MARGIN``."""
SMALLEST_MULTIPLIER = 0.05
"""A condition conflicts with another one if its multiplier, relative to the largest one, exceeds this."""
RELATIONS = {1.0: "<=", -1.0: ">="}
UNBOUNDED = Range(minimum=-np.inf, maximum=np.inf)
"""The range of a scalar without a constraint."""
RADIUS_TOLERANCE = 1e-7
"""A spectral radius at its bound may exceed it by this fraction of the bound."""
FIRST_REDUCTION, SMALLEST_REDUCTION = 0.1, 0.02
"""First and smallest step by which the bound of the radius is reduced, relative to the bound. If the smallest one
fails, the search ends."""
STEP_ITERATIONS = 60
"""Largest number of iterations for one step of that bound; a step that succeeds takes 15 to 40."""
CLOSE_ITERATIONS = 25
"""Largest number of iterations of a search that stays close to a known optimum; one that succeeds takes 7 to 15."""

_Begin: TypeAlias = tuple[Motion, Array, Array, list[float]]
"""Motion, torque values, durations and freed parameters with which a search starts."""
_Found: TypeAlias = tuple[Collocation, IpoptResult]


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenLoopOptimum:
    """The end of a search.

    Attributes
    ----------
    problem : the problem with the torques fixed in time; its ``origin`` is the problem that was solved.
    collocation, x : the last program, and its solution.
    solver : entries of ``Gait.solver``.
    """

    problem: Problem
    collocation: Collocation
    x: Array
    solver: Mapping[str, float | str]


@overflow_allowed()
def optimise(
    problem: Problem,
    system: HybridSystem,
    *,
    start: Gait | None = None,
    intervals: int = INTERVALS,
    progress: Valued = None,
    should_stop: Stop = None,
) -> OpenLoopOptimum | Gait:
    """The optimum next to the guess of a problem, or the attempt that failed.

    Parameters
    ----------
    system : system of the problem, whose law has no duration.
    start : a gait at which the search starts instead of the guess.
    intervals : smallest number of intervals of the collocation.
    """
    law = problem.control
    assert isinstance(law, OpenLoop)
    dynamics, iterations = Dynamics.of(system, problem.parameters), 0
    free = {key: (each.lower, each.upper) for key, each in problem.free.items()}
    limit = problem.constraints.get(RADIUS, UNBOUNDED).maximum

    def search(begin: _Begin, extra: ExtraPoints, again: _Found | None, radius: float = np.inf) -> _Found:
        nonlocal iterations
        close = known and again is None
        for _ in range(MAX_EXCHANGES):
            collocation = _collocation(problem, system, begin[2], free, radius=radius, intervals=intervals, extra=extra)
            limit = CLOSE_ITERATIONS if close else STEP_ITERATIONS if np.isfinite(radius) else MAX_ITERATIONS
            result = collocation.solve(
                *begin, progress=progress, should_stop=should_stop, again=again, close=close, max_iterations=limit
            )
            iterations += result.iterations
            converged = result.status is Status.CONVERGED
            lost = close and not converged and result.status is not Status.INTERRUPTED
            passed = converged and not collocation.in_order(result.w)  # a switch a breakpoint of the torques
            if lost or passed:
                begin, extra = (_begin(collocation, result.w), ExtraPoints()) if passed else (begin, extra)
                again, close = None, False
                continue
            more = tuple(collocation.violated(result.w, SAMPLES, VIOLATED_MARGIN, beside=BESIDE)) if converged else ()
            if not more:
                break
            begin, extra, again = _begin(collocation, result.w), (*extra, *more), (collocation, result)
            close = False
        return collocation, result

    def failed(found: _Found, status: Status, message: str, causes: tuple[Cause, ...]) -> Gait:
        collocation, result = found
        values, first, lengths = _unpacked(collocation, result.w)
        best = best_point(problem, first, lengths, values) if np.isfinite(result.w).all() else None
        return Gait(
            problem=problem,
            dynamics=dynamics,
            status=status,
            message=message,
            solver=_solver_record(result, iterations),
            causes=causes,
            best=best,
        )

    states, durations = guessed_states(problem, dynamics, start)
    values = np.array([c for row in law.values.values() for c in row], dtype=float)
    known = start is not None and isinstance(start.system.control, OpenLoop)
    if start is not None and known:
        values = np.array(
            [start.dynamics.parameter(f"control.{name}.{k}") for name in law.values for k in range(law.count)]
        )
    begin, extra = (states, values, durations, [dynamics.parameter(key) for key in free]), ExtraPoints()
    if known:
        collocation = _collocation(problem, system, durations, free, radius=np.inf, intervals=intervals)
        extra = tuple(collocation.violated(collocation.start(*begin), SAMPLES, SUSPECT_MARGIN, beside=BESIDE))
    found = search(begin, extra, None)
    collocation, result = found
    if result.status is not Status.CONVERGED:
        status, message, causes = result.status, result.message, tuple[Cause, ...]()
        if status is not Status.INTERRUPTED:
            causes = tuple(_conflicts(_without_radius(problem), system, free, begin, should_stop))
            status = Status.INFEASIBLE if causes else status
            causes = causes or tuple(collocation.worst(result.w))
            reasons = "\n".join(cause.description for cause in causes)
            limits = what_limits(*_labelled(collocation), result)
            message = reasons if status is Status.INFEASIBLE else ": ".join(filter(None, (message, limits, reasons)))
        return failed(found, status, message, causes)

    # the bound is reduced step by step from the radius of the optimum without it; a step that fails is halved
    best, reduction = largest_modulus(collocation, result.w) if np.isfinite(limit) else 0.0, FIRST_REDUCTION
    while best > limit * (1 + RADIUS_TOLERANCE):
        bound = max(limit, (1 - reduction) * best)
        collocation, result = search(_begin(found[0], found[1].w), found[0].extra, found, bound)
        # the inequalities hold again if two multipliers have left the circle together, so that the radius is checked
        if result.status is Status.CONVERGED and largest_modulus(collocation, result.w) <= bound * (
            1 + RADIUS_TOLERANCE
        ):
            found, best, reduction = (collocation, result), bound, min(0.5, 2 * reduction)
            continue
        reduction /= 2
        if result.status is Status.INTERRUPTED:
            return failed((collocation, result), result.status, result.message, ())
        if reduction < SMALLEST_REDUCTION:
            _, location = problem.place.locate(("constraints", RADIUS))
            message = f"{location}: {RADIUS} <= {limit:g} was not met: best reached {best:.4g}"
            cause = Cause(what=RADIUS, description=message, needed=limit, available=best)
            return failed((collocation, result), Status.NOT_CONVERGED, message, (cause,))
    vanishing = found[0].vanishing(found[1].w)
    if vanishing is not None:
        return failed(found, Status.NOT_CONVERGED, vanishing.description, (vanishing,))
    return _optimum(problem, found[0], found[1].w, _solver_record(found[1], iterations))


def _without_radius(problem: Problem) -> Problem:
    """The problem without the bound on the spectral radius, which ``Collocation`` does not state."""
    return replace(problem, constraints={key: span for key, span in problem.constraints.items() if key != RADIUS})


def _collocation(
    problem: Problem,
    system: HybridSystem,
    durations: Array,
    free: Mapping[str, tuple[float, float]],
    *,
    radius: float | None = None,
    intervals: int = INTERVALS,
    extra: ExtraPoints = (),
) -> Collocation:
    """The program of a problem; ``radius`` is the bound on the multipliers, by default that of the problem."""
    goals, bound = _without_radius(problem), problem.constraints.get(RADIUS)
    timed = bound is not None
    program = Collocation(goals, system, durations, free=free, intervals=intervals, extra=extra, timed=timed)
    radius = bound.maximum if radius is None and bound is not None else radius
    if radius is not None and np.isfinite(radius):
        bound_radius(program, radius)
    return program


def _begin(collocation: Collocation, x: Array) -> _Begin:
    """A solution as the start of another search."""
    blocks = collocation.unpack(x)
    return _Polynomials(collocation, x), blocks["values"], blocks["durations"], blocks["freed"].tolist()


def _solver_record(result: IpoptResult, iterations: int) -> dict[str, float | str]:
    """Entries of ``Gait.solver``; the residual of the optimality conditions is relative to the objective."""
    kkt = result.kkt / max(abs(result.objective), 1.0)
    return {"iterations": float(iterations), "kkt": kkt, "objective": result.objective}


def _unpacked(collocation: Collocation, x: Array) -> tuple[dict[str, float], Array, Array]:
    """Torques and free parameters of a solution by dotted key, its first state, and the durations of its phases."""
    blocks = collocation.unpack(x)
    values = (*blocks["values"].tolist(), *blocks["freed"].tolist())
    known = dict(zip((*collocation.value_keys, *collocation.free), values, strict=True))
    return known, blocks["states"][0], blocks["durations"]


def _optimum(
    problem: Problem, collocation: Collocation, x: Array, solver: Mapping[str, float | str]
) -> OpenLoopOptimum:
    """A solution with the torques and the free parameters of the problem fixed."""
    known, state, lengths = _unpacked(collocation, x)
    first = dict(zip(collocation.system.state_names, state.tolist(), strict=True))
    durations = lengths.tolist()
    return OpenLoopOptimum(
        problem=problem.with_torques(known, first, durations),
        collocation=collocation,
        x=x,
        # duration of the law, from which that of the gait's step differs by the error of the collocation
        solver={**solver, "duration": float(sum(durations)) / len(problem.cycle.steps)},
    )


def finished(optimum: OpenLoopOptimum, system: HybridSystem) -> Gait:
    """The gait of an optimum under its torques, which are fixed in time in ``system``."""
    problem, collocation = optimum.problem, optimum.collocation
    dynamics, origin = Dynamics.of(system, problem.parameters), problem.origin
    gait = checked_gait(problem, collocation.on_mesh(optimum.x, dynamics), optimum.solver)
    if not gait.converged or origin is None:
        return gait
    freed = {key: dynamics.parameter(key) for key in [*collocation.free, *collocation.value_keys]}
    objective = sum(weight * gait.scalar(name) for name, weight in origin.objective.items())
    return replace(gait, freed=freed, solver={**optimum.solver, "objective": float(objective)})


def keeps_contact(gait: Gait) -> bool:
    """Whether the stance foot sticks and presses along the whole motion of a gait, not only at collocation points."""
    needed, lowest = gait.measures.get("required_friction"), gait.measures.get("min_normal_force")
    sticks = needed is None or not needed > gait.dynamics.static_friction
    return sticks and (lowest is None or not lowest < 0)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class CollocationProgram(NonlinearProgram):
    """The program of direct collocation, whose unknowns include torques.

    Attributes
    ----------
    collocation : the collocation, with its mesh, points and equations.
    built : maps a problem whose torques are known to its system.
    """

    collocation: Collocation
    built: Callable[[Problem], HybridSystem]

    @property
    def system(self) -> HybridSystem:
        """The system whose parameters are p."""
        return self.collocation.system

    @property
    def free(self) -> tuple[str, ...]:
        """Dotted keys of the torques and the freed parameters."""
        return (*self.collocation.value_keys, *self.collocation.free)

    @property
    def n_nodes(self) -> int:
        """Number of points at which the states are unknowns."""
        return self.collocation.n_states

    @property
    def derivatives(self) -> dict[str, Function]:
        """Exact sparse derivatives as options of ``casadi.nlpsol``, which needs seconds to find them by itself."""
        return self.collocation.program.derivatives

    def node_times(self, durations: Array) -> Array:
        """Times of the points since the last impact, shape (n_nodes,) [s]."""
        return self.collocation.points.times(durations)

    def refined(self, w: Array) -> "CollocationProgram | None":
        """The program with margins also at those points between the present ones at which a solution violates them.

        It starts from the solution. It is None if the solution violates no margin.
        """
        x, collocation = self._checked(w), self.collocation
        more = tuple(collocation.violated(x, SAMPLES, VIOLATED_MARGIN))
        if not more:
            return None
        blocks, extra = collocation.unpack(x), (*collocation.extra, *more)
        begin = _Polynomials(collocation, x), blocks["values"], blocks["durations"], blocks["freed"].tolist()
        finer = _collocation(self.problem, self.system, blocks["durations"], collocation.free, extra=extra)
        return _program(self.problem, finer, begin, self.built)

    def _gait(self, problem: Problem, point: Array, p: Array) -> Gait:
        optimum = _optimum(problem, self.collocation, point, {"method": EXTERNAL})
        system = self.built(optimum.problem)
        equal = [k for k, label in enumerate(self.g_labels) if self.lbg[k] == self.ubg[k] and label.name in STRUCTURAL]
        off = np.asarray(self._constraints(point, p)).ravel()[equal] - self.lbg[equal]
        worst = int(np.argmax(np.abs(off)))
        if not abs(off[worst]) <= LARGEST_RESIDUAL:
            text = f"{self.g_labels[equal[worst]]} is off by {abs(off[worst]):.3g}"
            cause: Cause | None = Cause(what="motion", description=text, needed=0.0, available=float(off[worst]))
        else:
            cause = self._violated_bound(point, p)
        if cause is not None:
            at = self.collocation.on_mesh(point, Dynamics.of(system, optimum.problem.parameters))
            return failed_gait(optimum.problem, at, (cause,), optimum.solver)
        return finished(optimum, system)


def open_loop_program(
    problem: Problem, system: HybridSystem, built: Callable[[Problem], HybridSystem]
) -> CollocationProgram:
    """The program that ``optimise`` solves first; see there, and for ``built`` see ``CollocationProgram``."""
    law = problem.control
    assert isinstance(law, OpenLoop)
    dynamics, free = Dynamics.of(system, problem.parameters), problem.free
    states, durations = guessed_states(problem, dynamics, None)
    values = np.array([c for row in law.values.values() for c in row], dtype=float)
    bounds = {key: (each.lower, each.upper) for key, each in free.items()}
    collocation = _collocation(problem, system, durations, bounds)
    begin = states, values, durations, [dynamics.parameter(key) for key in free]
    return _program(problem, collocation, begin, built)


def _labelled(collocation: Collocation) -> tuple[tuple[Block], tuple[Block]]:
    """Unknowns and rows of a collocation with their meaning."""
    unknowns, rows = collocation.blocks
    return (replace(unknowns, labels=collocation.x_labels),), (replace(rows, labels=collocation.g_labels),)


def _program(
    problem: Problem,
    collocation: Collocation,
    begin: _Begin,
    built: Callable[[Problem], HybridSystem],
) -> CollocationProgram:
    """A collocation as a program for users, which starts from a motion, torques, durations and freed parameters."""
    unknowns, rows = _labelled(collocation)
    return CollocationProgram(
        unknowns=unknowns,
        rows=rows,
        p=collocation.program.p,
        f=collocation.program.f,
        x0=collocation.start(*begin),
        p0=collocation.dynamics.p,
        problem=problem,
        collocation=collocation,
        built=built,
    )


@dataclass(frozen=True, slots=True)
class _Polynomials:
    """The motion of a collocation."""

    collocation: Collocation
    x: Array

    def __call__(self, phase: int, times: Array) -> Array:
        return self.collocation.states_at(self.x, phase, times)


@dataclass(frozen=True, slots=True)
class _Known:
    """The motion of a gait."""

    gait: Gait

    def __call__(self, phase: int, times: Array) -> Array:
        arcs = [arc for arc, of_phase in self.gait.arcs_by_phase if of_phase == phase]
        states = np.empty((times.size, self.gait.system.n_z))
        of_arc = np.minimum(np.searchsorted([arc.end for arc in arcs], times), len(arcs) - 1)
        for k in np.unique(of_arc).tolist():
            arc, mine = arcs[k], of_arc == k
            states[mine] = np.stack([np.interp(times[mine], arc.times, column) for column in arc.states.T], axis=1)
        return states


def guessed_states(problem: Problem, dynamics: Dynamics, start: Gait | None) -> tuple[Motion, Array]:
    """The motion with which a search begins, and durations of the phases.

    It is the motion of the gait ``start``, if there is one; or the motion from the guess, if the walker takes a step
    with the guessed torques; or a straight one, from the guessed posture just after the impact to the posture that the
    impact maps to it.
    """
    if start is not None and start.steps:
        return _Known(start), np.array([duration for _, duration in start.phases])
    if problem.guess.first is None and problem.guess.durations is None:
        rolled = guessed_motion(problem, dynamics)
        if rolled.endless is None:
            return lambda phase, times: rolled(phase, times).T, np.array(rolled.durations)
    return straight_motion(problem, dynamics)


def _conflicts(
    problem: Problem,
    system: HybridSystem,
    free: Mapping[str, tuple[float, float]],
    begin: _Begin,
    should_stop: Stop,
) -> Iterator[Cause]:
    """Constraints that the others exclude, each with its best attainable value and the conditions in the way.

    For each constraint the program without it seeks that best value.

    Parameters
    ----------
    begin : motion, torque values, durations and freed parameters with which each search starts.
    """
    for name, span in problem.constraints.items():
        if name == CLEARANCE or name.startswith(ANGLE):
            continue
        others = {key: other for key, other in problem.constraints.items() if key != name}
        for sign, bound in ((-1.0, span.minimum), (1.0, span.maximum)):
            if not np.isfinite(bound):
                continue
            best = replace(problem, objective={name: sign}, constraints=others)
            collocation = Collocation(best, system, begin[2], free=free)
            result = collocation.solve(*begin, should_stop=should_stop)
            if result.status is not Status.CONVERGED:
                continue
            best_value = sign * result.objective
            if sign * (bound - best_value) >= -LARGEST_VIOLATION * max(1.0, abs(bound)):
                continue
            active = collocation.active(result.multipliers, result.bound_multipliers)
            against = ", ".join(
                key if "." in key else key.replace("_", " ") for key, size in active if size > SMALLEST_MULTIPLIER
            )
            _, location = problem.place.locate(("constraints", name))
            relation = "=" if span.is_equality else RELATIONS[sign]
            conflict = f"{name} {relation} {bound:g} conflicts with {against}: best reached {best_value:.4g}"
            yield Cause(what=name, description=f"{location}: {conflict}", needed=bound, available=best_value)
