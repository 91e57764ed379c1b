"""From a problem to its hybrid system and its gait.

The reference of a PD law is a gait of its own file, which is solved first. ``solve_sequence`` chooses between ``nlp``
and ``design``.
"""

import time
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from gaitopt.callbacks import Stop, Valued
from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait import curves
from gaitopt.gait.gait import Gait, Status
from gaitopt.gait.trajectory import Arc
from gaitopt.model.control import (
    BeyondEnd,
    BezierTracking,
    ConstantTorque,
    Control,
    NoControl,
    Piece,
    ProportionalDerivative,
    Reference,
    continued,
    control_points,
)
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.friction import Friction, ImpactLaw
from gaitopt.model.system import HybridSystem
from gaitopt.model.walker import Walker
from gaitopt.nlp.interval import integrate_to
from gaitopt.nlp.solve import free_parameters, solve_gait
from gaitopt.problem.problem import Problem
from gaitopt.problem.schema import ConstantTorqueSpec, CurveReference, CurveSpec, PDSpec

FLOW_PERIODS = 2
"""Periods by which a reference with ``beyond_end: flow`` extends past its end; no step takes that long."""
FLOW_POINTS = 33
"""Chebyshev points of a piece of that extension; a piece that they do not resolve is halved."""
FITTED_POINTS = 101
"""Points at which the first guess of a free curve is fitted."""
SHORTEST_PIECE = 1 / 64
"""Shortest piece in periods; a motion that is not smooth on this scale is no walk."""
KEPT = 16
"""Number of systems kept with their compiled functions, some megabytes each."""


def build_system(problem: Problem, *, should_stop: Stop = None) -> HybridSystem:
    """The hybrid system of a problem's walker, control, impact law and friction.

    Problems that differ in parameter values alone share one system, whose functions are compiled once.

    Parameters
    ----------
    should_stop : polled while the reference of a PD law is solved.

    Raises
    ------
    SolveError
        If the reference of a PD law is not a gait.
    """
    structure = _Structure(
        walker=type(problem.walker),
        law=problem.impact_law,
        friction=problem.friction_law,
        control=_control_structure(problem),
        problem=problem,
        should_stop=should_stop,
    )
    return _shared_system(structure)


def problem_dynamics(problem: Problem, *, should_stop: Stop = None) -> Dynamics:
    """The system of a problem at its parameters; raises as ``build_system``."""
    system = build_system(problem, should_stop=should_stop)
    return Dynamics(system, system.values(problem.parameters))


def solve_sequence(
    problem: Problem, *, start: Gait | None = None, progress: Valued = None, should_stop: Stop = None
) -> Gait:
    """The gait of a problem whose mode sequence is given: designed if parameters are unknown, solved otherwise.

    Parameters
    ----------
    start : a gait of the same system with the same mode sequence from which a design starts instead of the guess.
    progress : called at every iteration with its number and the largest violation.
    should_stop : polled at every iteration; True ends the search with the status ``interrupted``.

    Raises
    ------
    SolveError
        If the reference of a PD law is not a gait.
    """
    system = build_system(problem, should_stop=should_stop) if start is None else start.system
    began = time.perf_counter()
    designed = bool(free_parameters(problem, system))
    first = start if designed and start else solve_gait(problem, system, progress=progress, should_stop=should_stop)
    if not designed or first.status is Status.INTERRUPTED:
        return first
    from gaitopt.design.design import design_gait  # most problems have no unknowns and need not load its modules

    gait = design_gait(problem, system, first, progress=progress, should_stop=should_stop)
    return replace(gait, solver={**gait.solver, "seconds": time.perf_counter() - began})


def gait_reference(gait: Gait, beyond_end: BeyondEnd) -> Reference:
    """The joint angles of a gait as a reference for a PD law, extended past its end.

    ``flow`` extends it by the motion in the gait's last mode, as if the swing foot did not touch the ground.
    """
    tracked = [gait.system.walker.shape.index(name) for name in gait.system.walker.tracked]
    pieces = [_piece(gait, arc, tracked) for arc in gait.arcs]
    if beyond_end is not BeyondEnd.FLOW:
        return continued(pieces, gait.period, beyond_end)
    arc, duration = gait.arcs[-1], gait.period
    unit = gait.dynamics.state_units
    while arc.end < (1 + FLOW_PERIODS) * gait.period:
        beyond = _flow_on(gait, arc, duration)
        if curves.tail(beyond.states / unit) > curves.RESOLVED and duration > SHORTEST_PIECE * gait.period:
            duration /= 2
            continue
        arc = beyond
        pieces.append(_piece(gait, arc, tracked))
    return Reference(pieces=tuple(pieces), horizon=arc.end)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Structure:
    """The properties that determine a system's functions; ``problem`` and ``should_stop`` build them the first time."""

    walker: type[Walker]
    law: ImpactLaw
    friction: Friction
    control: tuple[object, ...]
    problem: Problem = field(compare=False)
    should_stop: Stop = field(compare=False)


@lru_cache(maxsize=KEPT)
def _shared_system(structure: _Structure) -> HybridSystem:
    control = _control(structure.problem, structure.should_stop)
    return HybridSystem(structure.walker, control, structure.law, structure.friction)


def _control_structure(problem: Problem) -> tuple[object, ...]:
    """The control law without the values of its parameters."""
    spec = problem.control
    if isinstance(spec, ConstantTorqueSpec):
        return (spec.type, *spec.torques)
    if isinstance(spec, PDSpec):
        source = _source(problem)
        return (spec.type, spec.reference.model_dump_json(), source.digest, type(source.walker))
    return (spec.type,)


def _control(problem: Problem, should_stop: Stop) -> Control:
    spec = problem.control
    if isinstance(spec, ConstantTorqueSpec):
        return ConstantTorque(torques=dict(spec.torques))
    if isinstance(spec, PDSpec):
        source = _reference_gait(problem, should_stop)
        if isinstance(spec.reference, CurveReference):
            return _curve_tracking(problem, spec, spec.reference, source)
        reference = gait_reference(source, spec.reference.beyond_end)
        return ProportionalDerivative(kp=spec.kp, kd=spec.kd, reference=reference)
    return NoControl()


def _reference_gait(problem: Problem, should_stop: Stop) -> Gait:
    source = _source(problem)
    if source.walker.shape != problem.walker.shape:
        raise ProblemError(
            f"{problem.name}: control.reference: {source.name} moves {', '.join(source.walker.shape)}, "
            f"but this walker moves {', '.join(problem.walker.shape)}; name a gait of the same kind of walker"
        )
    gait = solve_sequence(source, should_stop=should_stop)
    if not gait.converged:
        raise SolveError(f"{problem.name}: its reference {source.name} is {gait.status}: {gait.message}")
    return gait


def _source(problem: Problem) -> Problem:
    if problem.reference is None:
        raise ProblemError(f"{problem.name}: control.reference names no problem")
    return problem.reference


def _curve_tracking(problem: Problem, spec: PDSpec, curve: CurveReference, start: Gait) -> BezierTracking:
    """Curves with the guessed control points; without a guess, the best fit to the reference gait's joint angles."""
    points = curve.curve.points or _fitted_points(problem, curve.curve, start)
    return BezierTracking(
        kp=spec.kp,
        kd=spec.kd,
        points={name: points[name] for name in problem.walker.tracked},
        duration=curve.curve.duration or start.period,
        beyond_end=BeyondEnd(curve.beyond_end),
        within=curve.curve.within,
    )


def _fitted_points(problem: Problem, curve: CurveSpec, start: Gait) -> dict[str, tuple[float, ...]]:
    """Control points, within their bound, of the curves closest to the gait's joint angles."""
    phases = np.linspace(0, 1, FITTED_POINTS)
    angles, _ = gait_reference(start, BeyondEnd.HOLD)(phases * start.period)
    points = np.clip(control_points(phases, angles, curve.degree), -curve.within, curve.within)
    return {name: tuple(map(float, row)) for name, row in zip(problem.walker.tracked, points, strict=True)}


def _piece(gait: Gait, arc: Arc, tracked: list[int]) -> Piece:
    offset = gait.system.n_shape + 1
    series = curves.coefficients(arc.states).T
    return Piece(start=arc.start, end=arc.end, angles=series[tracked], rates=series[[offset + k for k in tracked]])


def _flow_on(gait: Gait, arc: Arc, duration: float) -> Arc:
    """The motion in an arc's mode for ``duration`` after its end."""
    times = arc.end + duration * (curves.points(FLOW_POINTS) + 1) / 2
    data = gait.system.control.data(arc.segment)
    states = integrate_to(gait.system, arc.mode, arc.states[-1], times, arc.dynamics.p, data)
    return replace(arc, times=times, states=states)
