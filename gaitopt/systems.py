"""From a problem to its hybrid system and its gait.

If the control law refers to the gait of another problem, that gait is solved first. ``solve_sequence`` chooses between
``solver`` and ``design``.
"""

import time
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np

from gaitopt.callbacks import Stop, Valued
from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait import curves
from gaitopt.gait.gait import Gait, Status
from gaitopt.gait.measures import angles_of
from gaitopt.gait.trajectory import Arc
from gaitopt.model.control import Control
from gaitopt.model.curve import BeyondEnd, Curve, Piece, bezier_curve, continued, control_points
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.open_loop import OpenLoop
from gaitopt.model.reference import CurveReference, GaitReference, Reference
from gaitopt.model.step_feedback import Resolved
from gaitopt.model.system import HybridSystem
from gaitopt.model.virtual_constraints import VirtualConstraints
from gaitopt.problem.faults import raise_faults
from gaitopt.problem.problem import Problem
from gaitopt.problem.rules import torque_faults
from gaitopt.requests import DEFAULT_LIMITS, Method, SearchLimits
from gaitopt.solver.feedback_gains import designed_gains, return_map_derivatives
from gaitopt.solver.interval import integrate_to
from gaitopt.solver.program import NonlinearProgram, feasibility
from gaitopt.solver.rollout import guessed_motion
from gaitopt.solver.solve import OTHER_METHODS, free_parameters, solve_gait
from gaitopt.threads import Uncompared

FLOW_PERIODS = 2
"""Number of periods by which a reference with ``beyond_end: flow`` is extended past its end; no step takes longer."""
FLOW_POINTS = 33
"""Number of Chebyshev points of a piece of such an extension; a piece that they do not resolve is halved."""
FITTED_POINTS = 101
"""Number of points at which curves are fitted to the motion of a gait."""
SHORTEST_PIECE = 1 / 64
"""Length of the shortest piece of an extension in periods; a motion that is not smooth on this scale is not a walk."""
MAX_SYSTEMS = 16
"""Number of systems in the cache with their compiled functions, some megabytes each."""


def build_system(problem: Problem, *, should_stop: Stop = None) -> HybridSystem:
    """The hybrid system of a problem's walker, control, impact law and friction.

    Problems that only differ in parameter values share one system, whose functions are compiled once.

    Parameters
    ----------
    should_stop : polled while the reference of a control law is solved.

    Raises
    ------
    SolveError
        If the reference of a control law is not a gait.
    """
    control, source, nominal = problem.control.structure, _source(problem), problem.nominal
    tracked: tuple[object, ...] = () if source is None else (source.digest, type(source.walker))
    tracked += () if nominal is None else (nominal.digest,)
    key = (type(problem.walker), problem.impact_law, problem.friction_law, problem.cycle_end, *control, *tracked)
    return _shared_system(key, Uncompared((problem, should_stop)))


def problem_dynamics(problem: Problem, *, should_stop: Stop = None) -> Dynamics:
    """The system of a problem at its parameters; raises the errors of ``build_system``."""
    return Dynamics.of(build_system(problem, should_stop=should_stop), problem.parameters)


def solve_sequence(
    problem: Problem,
    *,
    start: Gait | None = None,
    method: Method = Method.AUTO,
    limits: SearchLimits = DEFAULT_LIMITS,
    progress: Valued = None,
    should_stop: Stop = None,
) -> Gait:
    """The gait of a problem whose mode sequence is given: designed if parameters are unknown, solved otherwise.

    Parameters
    ----------
    start : a gait of the same system with the same mode sequence from which a design starts instead of the guess.
    method : method of the search for the gait, see ``Method``. With ``newton`` a design uses sequential quadratic
        programming only, and not IPOPT.
    limits : limits of the search for a gait at given parameters; designs have their own.
    progress : called at every iteration with its number and the largest violation.
    should_stop : polled at every iteration; True ends the search with the status ``interrupted``.

    Raises
    ------
    SolveError
        If the reference of a control law is not a gait.
    """
    began = time.perf_counter()
    if isinstance(problem.control, OpenLoop) and problem.control.duration is None:
        if method is Method.NEWTON:
            reason, dynamics = f"open-loop torques are found by IPOPT; {OTHER_METHODS}", problem_dynamics(problem)
            return Gait(problem=problem, dynamics=dynamics, status=Status.NOT_CONVERGED, message=reason)
        gait = _open_loop_gait(problem, start, progress, should_stop)
        return replace(
            gait, solver={"method": Method.IPOPT.value, **gait.solver, "seconds": time.perf_counter() - began}
        )
    system = build_system(problem, should_stop=should_stop) if start is None else start.system
    designed = bool(free_parameters(problem, system))
    if designed and start:
        first = start
    else:
        first = solve_gait(problem, system, method=method, limits=limits, progress=progress, should_stop=should_stop)
    if not designed or first.status is Status.INTERRUPTED:
        return first
    from gaitopt.design.design import design_gait  # imported here, because most problems have no unknowns

    swift = method is Method.NEWTON
    gait = design_gait(problem, system, first, exact_only=swift, progress=progress, should_stop=should_stop)
    found_by = Method.NEWTON if swift else Method.IPOPT
    solver = {"method": found_by.value, **gait.solver, "seconds": time.perf_counter() - began}
    return replace(gait, solver=solver)


def _open_loop_gait(problem: Problem, start: Gait | None, progress: Valued, should_stop: Stop) -> Gait:
    """The optimum over open-loop torques, which are then fixed in time, on the first mesh that is fine enough."""
    from gaitopt.design.open_loop import MESHES, finished, keeps_contact, optimise  # only a few problems need it

    system, iterations = build_system(problem), 0.0
    for intervals in MESHES:
        end = optimise(problem, system, start=start, intervals=intervals, progress=progress, should_stop=should_stop)
        gait = end if isinstance(end, Gait) else finished(end, build_system(end.problem))
        iterations += float(gait.solver["iterations"])
        gait = replace(gait, solver={**gait.solver, "iterations": iterations})
        slips = gait.status is Status.INFEASIBLE or (gait.converged and not keeps_contact(gait))
        if isinstance(end, Gait) or not slips:
            break
        start = gait if gait.converged else start  # an optimum without an exact motion is not a start for the next one
    return gait


def problem_program(problem: Problem) -> NonlinearProgram:
    """The nonlinear program of a problem whose mode sequence is given, see ``gaitopt.nlp``.

    Raises
    ------
    ProblemError
        If the mode sequence is open.
    SolveError
        If the reference of a PD law is not a gait.
    """
    if problem.is_open:
        raise ProblemError(
            f"{problem.name}: gait.phases: auto leaves the mode sequence open, and so the equations; state the phases"
        )
    if isinstance(problem.control, OpenLoop) and problem.control.duration is None:
        from gaitopt.design.open_loop import open_loop_program

        return open_loop_program(problem, build_system(problem), build_system)
    system = build_system(problem)
    if not free_parameters(problem, system):
        dynamics = Dynamics(system, system.values(problem.parameters))
        return feasibility(problem, guessed_motion(problem, dynamics).on_mesh())
    from gaitopt.design.design import design_program

    return design_program(problem, system, solve_gait(problem, system))


def gait_curve(gait: Gait, beyond_end: BeyondEnd, followed: Mapping[str, str]) -> Curve:
    """The angles of a gait over the time since the impact, extended past its end.

    ``flow`` extends it by the motion in the gait's last mode, as if the swing foot did not touch the ground.

    Parameters
    ----------
    followed : shape coordinate, motor or phase variable of the gait for each joint that follows one.
    """
    system, names = gait.system, tuple(followed)
    tracked = [system.angle_names.index(name) for name in followed.values()]

    def piece(arc: Arc) -> Piece:
        angles = arc.states[:, : len(system.walker.shape)]
        if max(tracked, default=0) >= angles.shape[1]:  # not a state, but the angle of a motor or a phase variable
            angles = angles_of(arc)[0]
        rows = curves.coefficients(angles).T[tracked].tolist()
        return Piece(start=arc.start, end=arc.end, rows=tuple(map(tuple, rows)))

    pieces = [piece(arc) for arc in gait.arcs]
    if beyond_end is not BeyondEnd.FLOW:
        return continued(names, pieces, gait.scalar("period"), beyond_end)
    arc, duration = gait.arcs[-1], gait.scalar("period")
    while arc.end < (1 + FLOW_PERIODS) * gait.scalar("period"):
        times = arc.end + duration * (curves.points(FLOW_POINTS) + 1) / 2
        data = system.control.data(arc.segment)
        states = integrate_to(system, arc.mode, arc.states[-1], times, arc.dynamics.p, data)
        unresolved = curves.tail(states / gait.dynamics.state_units) > curves.RESOLVED
        if unresolved and duration > SHORTEST_PIECE * gait.scalar("period"):
            duration /= 2
            continue
        arc = replace(arc, times=times, states=states)
        pieces.append(piece(arc))
    return Curve(names=names, pieces=tuple(pieces), horizon=arc.end, beyond_end=beyond_end)


@lru_cache(maxsize=MAX_SYSTEMS)
def _shared_system(key: tuple[object, ...], stated: Uncompared[tuple[Problem, Stop]]) -> HybridSystem:
    """The system of a problem; ``key`` determines its functions."""
    problem, should_stop = stated.value
    control = _control(problem, should_stop)
    law = problem.friction_law
    if control.untimed is not control:
        return build_system(replace(problem, control=control.untimed)).retimed(control)
    system = HybridSystem(type(problem.walker), control, problem.impact_law, law, problem.cycle_end)
    if problem.control.source[0]:  # the torques of other laws are checked when their problem is read
        raise_faults(torque_faults(problem, control, lambda: system), problem.place)
    return system


def _control(problem: Problem, should_stop: Stop) -> Control:
    """The control law of a problem; the gait that it tracks is solved first."""
    source, law = _source(problem), problem.control
    if source is None:
        return _with_feedback(problem, law, should_stop)
    gait = solve_sequence(source, should_stop=should_stop)
    if not gait.converged:
        raise SolveError(f"{problem.name}: its reference {source.name} is {gait.status}: {gait.message}")
    bound = {name: _bound(reference, gait, problem) for name, reference in law.targets.items()}
    return _with_feedback(problem, law.model_copy(update=bound), should_stop)


def _with_feedback(problem: Problem, law: Control, should_stop: Stop) -> Control:
    """A law whose feedback from step to step has its numbers, which follow from the nominal gait.

    Raises
    ------
    SolveError
        If there is no nominal gait, or no gains as they are designed.
    ProblemError
        If a coordinate is not one of the section, or the nominal value of a parameter lies outside of its limits.
    """
    feedback, nominal = law.step_feedback, problem.nominal
    if feedback is None or feedback.is_known or nominal is None:
        return law
    if nominal.is_open:
        raise ProblemError(f"{problem.name}: control.step_feedback needs a mode sequence; state gait.phases")
    gait = solve_sequence(nominal, should_stop=should_stop)
    if gait.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    if not gait.converged:
        raise SolveError(
            f"{problem.name}: control.step_feedback: the gait without the feedback, to which it leads back, "
            f"is {gait.status}: {gait.message}"
        )
    section, stated = gait.system.section(gait.cycle), feedback.stated
    for key, name in stated:
        if name not in section.names:
            raise ProblemError(
                f"{problem.name}: control.step_feedback.gains.{key}: {name} is no coordinate of the section, which has "
                f"{', '.join(section.names)}"
            )
    if feedback.design is None:
        keys = tuple(dict.fromkeys(key for key, _ in stated))
        gains = np.array([[stated.get((key, name), 0.0) for name in section.names] for key in keys])
    else:
        every = (f"control.{key}" for key in law.parameters if not key.startswith("limits."))
        keys = feedback.corrects or tuple(every)
        units = gait.dynamics.state_units[section.indices]
        gains = designed_gains(problem.name, return_map_derivatives(gait, keys), units, feedback.design)
    for key, (low, high) in (feedback.limits or {}).items():
        if key in keys and not low <= gait.dynamics.parameter(key) <= high:
            raise ProblemError(
                f"{problem.name}: control.step_feedback.limits.{key}: [{low:g}, {high:g}] must contain the nominal "
                f"value {gait.dynamics.parameter(key):g}"
            )

    known = Resolved(
        keys=keys, names=section.names, gains=gains.reshape(len(keys), len(section.names)),
        state=gait.state[section.indices], every=len(gait.steps),
    )  # fmt: skip
    return law.model_copy(update={"step_feedback": feedback.resolved(known)})


def _bound(reference: Reference, gait: Gait, problem: Problem) -> Reference:
    """A reference of a problem's control law, completed by a curve of the gait that it names.

    Raises
    ------
    SolveError
        If the phase variable turns back along the gait.
    """
    law, followed, period = problem.control, reference.followed(type(problem.walker)), gait.scalar("period")
    if not isinstance(reference, GaitReference | CurveReference):
        return reference
    if isinstance(reference, GaitReference) and not law.phase_variable:
        assert reference.beyond_end is not None  # problems without it are rejected when they are read
        return reference.with_curve(gait_curve(gait, reference.beyond_end, followed))
    times, phase, span = np.linspace(0, period, FITTED_POINTS), law.phase_variable, (0.0, period)
    motion = gait_curve(gait, BeyondEnd.HOLD, {**followed, "": phase} if phase else followed)
    angles, along = motion(times)[0], times
    if phase:
        angles, along = angles[:-1], angles[-1]
        rates = np.diff(along)
        if not ((rates > 0).all() or (rates < 0).all()):
            time = float(times[1:][rates * rates[0] <= 0][0])
            fault = f"the phase variable {phase} is not monotone along {gait.problem.name}: it turns back"
            raise SolveError(f"{problem.name}: control.reference: {fault} {time:.4f} s after the impact")
        span = float(along[0]), float(along[-1])
        stated = law.span if isinstance(law, VirtualConstraints) else getattr(reference, "span", None)
        span = span if stated is None else (stated[0], stated[1])
    degree = (reference.degree or 1) if isinstance(reference, GaitReference) else reference.curve.degree
    rows, errors = control_points((along - span[0]) / (span[1] - span[0]), angles, degree)
    fitted = {name: tuple(map(float, row)) for name, row in zip(followed, rows, strict=True)}
    if isinstance(reference, GaitReference):
        largest = dict(zip(followed, errors.tolist(), strict=True))
        return reference.with_curve(bezier_curve(fitted, span, phase=phase, fit_errors=largest))
    curve, bound = reference.curve, reference.curve.within
    points = curve.points or {name: tuple(np.clip(row, -bound, bound).tolist()) for name, row in fitted.items()}
    if not phase:
        span, points = (0.0, curve.duration or period), {name: points[name] for name in followed}
    return reference.with_points(points, span, phase)


def _source(problem: Problem) -> Problem | None:
    """The problem whose gait the control law needs; None if it needs none."""
    if problem.control.source[0] and problem.reference is None:
        raise ProblemError(f"{problem.name}: control.reference names no problem")
    return problem.reference
