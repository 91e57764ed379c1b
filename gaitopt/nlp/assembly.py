"""From a solution of the periodic problem to the gait that it is: arcs, impact, multipliers, scalars."""

from collections.abc import Mapping

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait import curves
from gaitopt.gait.gait import Gait, Shooting, Status, floquet_multipliers
from gaitopt.gait.measures import measure
from gaitopt.gait.trajectory import Arc, ImpactRecord, Step
from gaitopt.model.buffered import buffered
from gaitopt.model.cycle import Cycle
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.margins import ending_margin
from gaitopt.model.modes import Mode
from gaitopt.nlp.layout import COINCIDENT, ArcLayout
from gaitopt.nlp.newton import Solution, return_map_jacobian
from gaitopt.nlp.shooting import Transcription
from gaitopt.problem.problem import Problem

COUNTS = (33, 65, 129, 257)
"""Chebyshev points tried in turn until an arc is resolved."""


def assemble_gait(
    problem: Problem,
    at: Solution[Transcription],
    *,
    errors: Array,
    message: str,
    solver: Mapping[str, float],
) -> Gait:
    """The gait at a solution; freed parameters are put into ``p`` and reported.

    Parameters
    ----------
    problem : the one that was solved.
    at : the solution.
    errors : ndarray, shape (n_phases,) - estimated integration error.
    """
    transcription = at.transcription
    w = _forward_in_time(transcription, at.w)
    nodes, _, freed = transcription.unpack(w)
    dynamics = transcription.dynamics(at.p, freed)
    steps = assemble_steps(transcription, w, at.p)
    return Gait(
        problem=problem,
        dynamics=dynamics,
        status=Status.CONVERGED,
        message=message,
        steps=steps,
        shooting=Shooting(
            times=transcription.node_times(w),
            states=nodes.T,
            intervals=tuple(arc.intervals for arc in transcription.layout.arcs),
            residual=at.size,
            errors=errors,
        ),
        multipliers=floquet_multipliers(return_map_jacobian(at)),
        measures=measure(dynamics, steps),
        freed=dict(zip(transcription.free, map(float, freed), strict=True)),
        solver=solver,
    )


def assemble_steps(problem: Transcription, w: Array, p: Array, counts: tuple[int, ...] = COUNTS) -> tuple[Step, ...]:
    """The steps that ``w`` describes; their arcs at the first of ``counts`` Chebyshev points that resolve them."""
    w = _forward_in_time(problem, w)
    nodes, _, freed = problem.unpack(w)
    dynamics, cycle = problem.dynamics(p, freed), problem.layout.cycle
    arcs: list[list[Arc]] = [[] for _ in cycle.steps]
    for index, arc in enumerate(problem.layout.arcs):
        arcs[cycle.step_of(arc.phase)].append(_arc(problem, w, p, index, counts))
    ends, walker = zip(arcs, cycle.impacts, problem.layout.impact_nodes, strict=True), problem.system.walker
    return tuple(
        Step(
            arcs=tuple(own),
            impact=impact_record(dynamics.standing(walker.side(step)), impact, nodes[:, end]),
        )
        for step, (own, impact, end) in enumerate(ends)
    )


def _forward_in_time(problem: Transcription, w: Array) -> Array:
    """The same unknowns with a duration of zero where rounding has made that of a vanishing phase negative."""
    nodes, durations, freed = problem.unpack(w)
    rounding = (durations < 0) & (durations > -COINCIDENT * durations.sum())
    return problem.pack(nodes, np.where(rounding, 0.0, durations), freed) if rounding.any() else w


def impact_record(dynamics: Dynamics, mode: Mode, z_minus: Array) -> ImpactRecord:
    """The impact in ``mode`` that follows ``z_minus``."""
    system, p = dynamics.system, dynamics.p
    z_plus, impulse, *_ = (value.copy() for value in buffered(system.impact(mode))(z_minus, p))
    _, stick_impulse, *_ = (value.copy() for value in buffered(system.impact(Mode.STICK))(z_minus, p))
    x, work = system.n_shape, float(system.push(z=z_minus, p=p)["work"]) if system.walker.pushes else 0.0
    state = z_plus.copy()
    state[x] = 0.0
    return ImpactRecord(
        mode=mode,
        state=state,
        step_length=float(z_plus[x]),
        impulse=impulse,
        stick_impulse=stick_impulse,
        push_work=work,
    )


def _arc(problem: Transcription, w: Array, p: Array, index: int, counts: tuple[int, ...]) -> Arc:
    layout = problem.layout.arcs[index]
    unit = problem.dynamics(p, problem.unpack(w).freed).state_units
    for count in counts:
        times, states = problem.sample(w, p, index, count)
        if curves.tail(states / unit) < curves.RESOLVED:
            break
    _rest_exactly(problem.layout.cycle, layout, states)
    side = problem.system.walker.side(problem.layout.cycle.step_of(layout.phase))
    return Arc(mode=layout.mode, segment=layout.segment, times=times, states=states, side=side)


def _rest_exactly(cycle: Cycle, arc: ArcLayout, states: Array) -> None:
    """Put to zero what Newton's method leaves of a slip velocity that an event makes zero: its sign is a decision."""
    if arc.mode.sticks:
        states[:, -1] = 0.0
    elif arc.start is None and cycle.onset_order(arc.phase) > 0:
        states[0, -1] = 0.0
    if arc.end is None and ending_margin(arc.mode, cycle.after(arc.phase)) == "slip_velocity":
        states[-1, -1] = 0.0
