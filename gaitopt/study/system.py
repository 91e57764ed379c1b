"""From a problem to its hybrid system; the reference of a PD law is solved first, from its own file."""

import numpy as np
from numpy.typing import NDArray

from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait import Arc, Gait, curves
from gaitopt.mechanics import (
    BeyondEnd,
    ConstantTorque,
    Control,
    HybridSystem,
    NoControl,
    Piece,
    ProportionalDerivative,
    Reference,
)
from gaitopt.mechanics.reference import continued
from gaitopt.nlp import integrate_to, solve_gait
from gaitopt.problem import ConstantTorqueSpec, GaitReference, PDSpec, Problem

Array = NDArray[np.float64]

FLOW_PIECES = 3
"""A reference that flows on is known for so many of its own periods past its end; no step takes that long."""
FLOW_COUNTS = (33, 65, 129, 257)
"""Chebyshev points tried in turn for a piece of that continuation."""


def build_system(problem: Problem) -> HybridSystem:
    """The hybrid system of a problem's walker, control and impact law.

    Raises
    ------
    SolveError
        If the reference of a PD law is not a gait.
    """
    return HybridSystem(type(problem.walker), _control(problem), problem.impact_law)


def gait_reference(gait: Gait, beyond_end: BeyondEnd) -> Reference:
    """The joint angles of a gait as a reference for a PD law, continued past its end.

    ``flow`` continues the motion of the gait's last mode as if the swing foot did not touch the ground.
    """
    assert gait.step is not None, "only a converged gait can be a reference"
    tracked = [gait.system.walker.shape.index(name) for name in gait.system.walker.tracked]
    pieces = [_piece(gait, arc, tracked) for arc in gait.step.arcs]
    if beyond_end is not BeyondEnd.FLOW:
        return continued(pieces, gait.step.period, beyond_end)
    arc = gait.step.arcs[-1]
    for _ in range(FLOW_PIECES):
        arc = _flow_on(gait, arc)
        pieces.append(_piece(gait, arc, tracked))
    return Reference(pieces=tuple(pieces), horizon=arc.end)


def _control(problem: Problem) -> Control:
    spec = problem.control
    if isinstance(spec, ConstantTorqueSpec):
        return ConstantTorque(torques=dict(spec.torques))
    if isinstance(spec, PDSpec):
        return ProportionalDerivative(kp=spec.kp, kd=spec.kd, reference=_reference(problem, spec))
    return NoControl()


def _reference(problem: Problem, spec: PDSpec) -> Reference:
    if not isinstance(spec.reference, GaitReference):
        raise ProblemError(f"{problem.name}: control.reference: a free curve is an unknown of a design, not of a gait")
    source = problem.reference_problem()
    assert source is not None, "a gait reference names a problem"
    if source.walker.shape != problem.walker.shape:
        raise ProblemError(
            f"{problem.name}: control.reference: {source.name} moves {', '.join(source.walker.shape)}, "
            f"but this walker moves {', '.join(problem.walker.shape)}; name a gait of the same kind of walker"
        )
    gait = solve_gait(source, build_system(source))
    if not gait.converged:
        raise SolveError(f"{problem.name}: its reference {source.name} is {gait.status}: {gait.message}")
    return gait_reference(gait, spec.reference.beyond_end)


def _piece(gait: Gait, arc: Arc, tracked: list[int]) -> Piece:
    offset = gait.system.n_shape + 1
    series = curves.coefficients(arc.states).T
    return Piece(start=arc.start, end=arc.end, angles=series[tracked], rates=series[[offset + k for k in tracked]])


def _flow_on(gait: Gait, arc: Arc) -> Arc:
    """The motion of an arc's mode for one more period of the gait."""
    assert gait.step is not None
    data = gait.system.control.data(arc.segment)
    for count in FLOW_COUNTS:
        times = arc.end + gait.step.period * (curves.points(count) + 1) / 2
        states = integrate_to(gait.system, arc.mode, arc.states[-1], times, gait.p, data)
        if curves.tail(states) < curves.RESOLVED:
            break
    return Arc(mode=arc.mode, segment=arc.segment, times=times, states=states)
