"""The gait of a solution of the equations, with arcs, impacts, multipliers and scalars; and the solution of a gait."""

import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait import curves
from gaitopt.gait.gait import Gait, Shooting, Status, floquet_multipliers
from gaitopt.gait.measures import exceeded_limits, measure
from gaitopt.gait.trajectory import Arc, Step, impact_record
from gaitopt.problem.problem import Problem
from gaitopt.requests import Method
from gaitopt.solver.mesh import COINCIDENT, mesh_of
from gaitopt.solver.newton import Solution
from gaitopt.solver.shooting import transcribe


def search_record(method: Method, iterations: int, began: float) -> dict[str, float | str]:
    """The record of a search in ``Gait.solver``; ``began`` is a time of ``time.perf_counter``."""
    return {"method": method.value, "iterations": float(iterations), "seconds": time.perf_counter() - began}


def solution_of(gait: Gait, free: tuple[str, ...] = ()) -> Solution:
    """The unknowns of a gait on the mesh on which it was solved.

    Parameters
    ----------
    free : dotted keys of the parameters that are unknowns, at their values in the gait.

    Raises
    ------
    ValueError
        If the gait is a failed attempt, or comes from a file or the simulator, so that its nodes are not known.
    """
    if gait.shooting is None:
        raise ValueError(f"{gait.problem.name}: a gait without its shooting nodes cannot be followed; solve it again")
    durations = np.array([duration for _, duration in gait.phases])
    mesh = mesh_of(gait.cycle, durations, gait.system.control.breakpoints)
    equations = transcribe(gait.system, mesh.refined(list(gait.shooting.intervals)), free)
    freed = tuple(gait.dynamics.parameter(key) for key in free)
    return Solution(equations, equations.pack(gait.shooting.states.T, durations, freed), gait.p)


def solved_gait(problem: Problem, refined: Solution, *, message: str, solver: Mapping[str, float | str]) -> Gait:
    """The gait at a refined solution.

    Its message says if the cycle repeats a shorter one, and names the joints whose limits the gait exceeds.
    """
    gait = assemble_gait(problem, refined, message=message, solver=solver)
    sentences, n, shorter = [message], len(gait.steps), gait.repeats_after
    if shorter != n:
        period = "every step" if shorter == 1 else f"{shorter} steps"
        sentences.append(f"the cycle of {n} steps repeats itself after {period}")
    return replace(gait, message="; ".join([*sentences, *exceeded_limits(gait.steps)]))


def assemble_gait(
    problem: Problem, at: Solution, *, message: str, solver: Mapping[str, float | str], errors: Array | None = None
) -> Gait:
    """The gait at a solution; free parameters are put into ``p`` and reported.

    Parameters
    ----------
    problem : the problem that was solved.
    at : the solution.
    errors : ndarray, shape (n_phases,) - estimated integration error; by default that of the solution.
    """
    forward, equations = _forward_in_time(at), at.equations
    nodes, durations, freed = equations.unpack(forward.w)
    steps = assemble_steps(forward)
    return Gait(
        problem=problem,
        dynamics=equations.dynamics(at.p, freed),
        status=Status.CONVERGED,
        message=message,
        steps=steps,
        shooting=Shooting(
            times=equations.mesh.node_times(durations),
            states=nodes.T,
            intervals=tuple(arc.intervals for arc in equations.mesh.arcs),
            residual=at.size,
            errors=at.errors if errors is None else errors,
        ),
        multipliers=floquet_multipliers(at.return_map.by_section),
        measures=measure(steps),
        freed=dict(zip(equations.free, map(float, freed), strict=True)),
        solver=solver,
        timed=equations.mesh.cycle.timed,
    )


def assemble_steps(at: Solution, counts: tuple[int, ...] = curves.COUNTS) -> tuple[Step, ...]:
    """The steps of a solution; each arc has the first number of Chebyshev points in ``counts`` that resolves it."""
    at, equations = _forward_in_time(at), at.equations
    nodes, cycle, table = equations.unpack(at.w).nodes, equations.mesh.cycle, equations.system.transitions
    per_phase, arcs = cycle.per_phase(equations.acting(at.w, at.p).steps), [list[Arc]() for _ in cycle.steps]
    for index, arc in enumerate(equations.mesh.arcs):
        dynamics = per_phase[arc.phase]
        for count in counts:
            times, states = equations.sample(at.w, at.p, index, count)
            if curves.tail(states / dynamics.state_units) < curves.RESOLVED:
                break
        # if an event makes the slip velocity zero, the sign of its rounding would decide a mode
        if arc.mode.fixes_x:
            states[:, -1] = 0.0
        elif arc.start is None and (arc.mode.direction or cycle.phases[arc.phase - 1].fixes_x):
            states[0, -1] *= cycle.onset_order(arc.phase) == 0
        if arc.end is None and "slip_velocity" in table.ending(cycle, arc.phase).zeros:
            states[-1, -1] = 0.0
        step = cycle.step_of(arc.phase)
        landings = dict(cycle.steps[step].landings)
        struck = landings.get(arc.phase - cycle.first_phases[step]) if arc.start is None else None
        arcs[step].append(
            Arc(dynamics=dynamics, mode=arc.mode, segment=arc.segment, times=times, states=states, struck=struck)
        )
    impacts = zip(arcs, cycle.impacts, equations.mesh.impact_nodes, strict=True)
    return tuple(
        Step(
            arcs=tuple(step_arcs),
            impact=impact_record(step_arcs[0].dynamics, impact, nodes[:, end], step_arcs[-1].mode),
        )
        for step_arcs, impact, end in impacts
    )


def _forward_in_time(at: Solution) -> Solution:
    """The solution with a duration of zero where rounding has made that of a vanishing phase negative."""
    nodes, durations, freed = at.equations.unpack(at.w)
    rounding = (durations < 0) & (durations > -COINCIDENT * durations.sum())
    if not rounding.any():
        return at
    return replace(at, w=at.equations.pack(nodes, np.where(rounding, 0.0, durations), freed))
