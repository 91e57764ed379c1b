"""From a solution of the equations to its gait (arcs, impacts, multipliers, scalars), and back to the solution."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait import curves
from gaitopt.gait.gait import Gait, Shooting, Status, floquet_multipliers
from gaitopt.gait.measures import measure
from gaitopt.gait.trajectory import Arc, Step, impact_record
from gaitopt.model.cycle import Cycle
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.transitions import Transitions
from gaitopt.nlp.layout import COINCIDENT, ArcLayout, layout
from gaitopt.nlp.newton import Solution, section_sensitivity
from gaitopt.nlp.shooting import MultipleShooting, transcribe
from gaitopt.problem.problem import Problem

COUNTS = (33, 65, 129, 257)
"""Chebyshev points tried in turn until an arc is resolved."""


def solution_of(gait: Gait, free: tuple[str, ...] = ()) -> Solution:
    """The unknowns of a gait on the layout on which it was solved.

    Parameters
    ----------
    free : dotted keys of the parameters that are unknowns, at their values in the gait.

    Raises
    ------
    ValueError
        If the gait is a failed attempt, or comes from a file or the simulator, so that its nodes are not known.
    """
    if gait.shooting is None:
        raise ValueError(f"{gait.problem.name}: a gait without its shooting nodes cannot be followed; solve it first")
    durations = np.array([duration for _, duration in gait.phases])
    plan = layout(gait.problem.cycle, durations, gait.system.control.breakpoints)
    equations = transcribe(gait.system, plan.refined(list(gait.shooting.intervals)), free)
    freed = tuple(gait.dynamics.parameter(key) for key in free)
    return Solution(equations, equations.pack(gait.shooting.states.T, durations, freed), gait.p)


def solved_gait(problem: Problem, refined: Solution, *, message: str, solver: Mapping[str, float]) -> Gait:
    """The gait at a refined solution; its message tells if the cycle is a shorter one walked several times."""
    gait = assemble_gait(problem, refined, errors=refined.errors, message=message, solver=solver)
    n, shorter = len(gait.steps), gait.repeats_after
    if shorter == n:
        return gait
    period = "every step" if shorter == 1 else f"{shorter} steps"
    return replace(gait, message=f"{message}; the cycle of {n} steps repeats itself after {period}")


def assemble_gait(problem: Problem, at: Solution, *, errors: Array, message: str, solver: Mapping[str, float]) -> Gait:
    """The gait at a solution; free parameters are put into ``p`` and reported.

    Parameters
    ----------
    problem : the one that was solved.
    at : the solution.
    errors : ndarray, shape (n_phases,) - estimated integration error.
    """
    equations = at.equations
    w = _forward_in_time(equations, at.w)
    nodes, _, freed = equations.unpack(w)
    dynamics = equations.dynamics(at.p, freed)
    steps = assemble_steps(equations, w, at.p)
    return Gait(
        problem=problem,
        dynamics=dynamics,
        status=Status.CONVERGED,
        message=message,
        steps=steps,
        shooting=Shooting(
            times=equations.node_times(w),
            states=nodes.T,
            intervals=tuple(arc.intervals for arc in equations.layout.arcs),
            residual=at.size,
            errors=errors,
        ),
        multipliers=floquet_multipliers(section_sensitivity(at)[1]),
        measures=measure(steps),
        freed=dict(zip(equations.free, map(float, freed), strict=True)),
        solver=solver,
    )


def assemble_steps(
    equations: MultipleShooting, w: Array, p: Array, counts: tuple[int, ...] = COUNTS
) -> tuple[Step, ...]:
    """The steps that ``w`` describes; their arcs at the first of ``counts`` Chebyshev points that resolve them."""
    w = _forward_in_time(equations, w)
    nodes, _, freed = equations.unpack(w)
    dynamics, cycle = equations.dynamics(p, freed), equations.layout.cycle
    per_phase, arcs = cycle.per_phase(dynamics.steps), [list[Arc]() for _ in cycle.steps]
    for index, arc in enumerate(equations.layout.arcs):
        arcs[cycle.step_of(arc.phase)].append(_arc(equations, w, p, index, per_phase[arc.phase], counts))
    impacts = zip(arcs, cycle.impacts, equations.layout.impact_nodes, strict=True)
    return tuple(
        Step(arcs=tuple(step_arcs), impact=impact_record(step_arcs[0].dynamics, impact, nodes[:, end]))
        for step_arcs, impact, end in impacts
    )


def _forward_in_time(equations: MultipleShooting, w: Array) -> Array:
    """The same unknowns with a duration of zero where rounding has made that of a vanishing phase negative."""
    nodes, durations, freed = equations.unpack(w)
    rounding = (durations < 0) & (durations > -COINCIDENT * durations.sum())
    return equations.pack(nodes, np.where(rounding, 0.0, durations), freed) if rounding.any() else w


def _arc(
    equations: MultipleShooting, w: Array, p: Array, index: int, dynamics: Dynamics, counts: tuple[int, ...]
) -> Arc:
    """One arc at as many Chebyshev points as resolve it."""
    arc, cycle = equations.layout.arcs[index], equations.layout.cycle
    for count in counts:
        times, states = equations.sample(w, p, index, count)
        if curves.tail(states / dynamics.state_units) < curves.RESOLVED:
            break
    _zero_slip_at_events(equations.system.transitions, cycle, arc, states)
    return Arc(dynamics=dynamics, mode=arc.mode, segment=arc.segment, times=times, states=states)


def _zero_slip_at_events(table: Transitions, cycle: Cycle, arc: ArcLayout, states: Array) -> None:
    """Set to zero the slip velocity where an event makes it zero: the sign of its rounding would decide a mode."""
    if arc.mode.sticks:
        states[:, -1] = 0.0
    elif arc.start is None and cycle.onset_order(arc.phase) > 0:
        states[0, -1] = 0.0
    if arc.end is None and "slip_velocity" in table.between(arc.mode, cycle.after(arc.phase)).zeros:
        states[-1, -1] = 0.0
