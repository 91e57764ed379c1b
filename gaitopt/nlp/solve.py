"""A problem's gait by multiple shooting: guess, Newton's method, polish, error estimate, refinement.

Where the guess is not close to a gait, or the gait there violates a margin, IPOPT searches.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.gait.gait import Cause, Gait, Status, in_words
from gaitopt.iteration import overflow_allowed
from gaitopt.model.cycle import Cycle
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.system import HybridSystem
from gaitopt.nlp.assembly import assemble_gait
from gaitopt.nlp.diagnosis import Feasibility, early_event, largest_residual, missing_event, violations
from gaitopt.nlp.ipopt import Progress
from gaitopt.nlp.layout import layout
from gaitopt.nlp.newton import Solution, polish, refine, solve_nearby
from gaitopt.nlp.rollout import Rollout, roll_out, transit_time
from gaitopt.nlp.shooting import Transcription, transcribe
from gaitopt.problem.plausibility import NO_ENERGY, lacks_energy
from gaitopt.problem.problem import Problem

MAX_REORDERS = 6
"""Times that switches and breakpoints may change their order; each is a new layout."""
RESIDUAL_TOLERANCE = 1e-9
"""Largest violation, in natural units, of any equality or margin in a solution that is called converged."""
VANISHING = 1e-7
"""A phase shorter than this part of the period does not take place."""
FAILURES = (Status.NOT_CONVERGED, Status.INFEASIBLE)


def find_gait(
    problem: Problem,
    system: HybridSystem,
    *,
    start: Gait | None = None,
    progress: Progress | None = None,
    should_stop: Stop = None,
) -> Gait:
    """The gait of ``problem``: designed where parameters are unknowns, solved otherwise.

    Parameters
    ----------
    start : a gait of the same system with the same mode sequence from which a design starts instead of the guess.
    progress : called at every iteration with its number and the largest violation.
    should_stop : polled at every iteration; True ends the search with the status ``interrupted``.
    """
    began = time.perf_counter()
    designed = free_parameters(problem, system)
    first = start if designed and start else solve_gait(problem, system, progress=progress, should_stop=should_stop)
    if not designed or first.status is Status.INTERRUPTED:
        return first
    from gaitopt.design.design import design_gait  # most problems have no unknowns, and need not wait for its modules

    gait = design_gait(problem, system, first, progress=progress, should_stop=should_stop)
    return replace(gait, solver={**gait.solver, "seconds": time.perf_counter() - began})


def free_parameters(problem: Problem, system: HybridSystem) -> dict[str, tuple[float, float]]:
    """Bounds of all unknown parameters by dotted key: those of the file, and those of the control law itself."""
    bounds = {key: (free.lower, free.upper) for key, free in problem.free.items()}
    return bounds | {f"control.{name}": limits for name, limits in system.control.unknowns.items()}


def solve_gait(
    problem: Problem,
    system: HybridSystem,
    *,
    progress: Progress | None = None,
    should_stop: Stop = None,
) -> Gait:
    """Solve ``problem`` for a periodic gait with its mode sequence.

    Parameters
    ----------
    problem : its guess starts the search.
    system : the hybrid system of the problem's walker and control.
    progress : called at every iteration with its number and the largest violation.
    should_stop : polled at every iteration; True ends the search with the status ``interrupted``.

    Returns
    -------
    gait : its status says whether it is one; numerical failure is not an error.
    """
    dynamics = Dynamics(system, system.values(problem.parameters))
    if lacks_energy(problem):
        no_energy = Cause(what="energy", words=NO_ENERGY)
        return Gait(
            problem=problem, dynamics=dynamics, status=Status.INFEASIBLE, message=NO_ENERGY, causes=(no_energy,)
        )
    began = time.perf_counter()
    state = np.array([problem.guess.state[name] for name in system.state_names])
    guess = roll_out(dynamics, problem.cycle, state, problem.guess.durations)
    if guess.endless is None:
        near = _in_order(
            problem.cycle, dynamics, guess, partial(solve_nearby, progress=progress, should_stop=should_stop)
        )
        if near.status is Status.CONVERGED:
            gait = _finish(problem, near, _solver(near, began))
            if gait.converged:
                return gait
    search = partial(_by_ipopt, progress=progress, should_stop=should_stop)
    attempt = _in_order(problem.cycle, dynamics, guess, search)
    if attempt.status in FAILURES and problem.guess.durations is None:
        shortened = np.array(guess.durations) * transit_time(dynamics, problem.cycle, state) / guess.period
        second = roll_out(dynamics, problem.cycle, state, shortened)
        retried = _in_order(problem.cycle, dynamics, second, search)
        attempt = retried if retried.status not in FAILURES else attempt
    solver = _solver(attempt, began)
    if attempt.status is not Status.CONVERGED:
        status, message = attempt.status, attempt.words
        causes = () if status is Status.INTERRUPTED else _causes(attempt, guess)
        message = f"{message}: {in_words(causes)}" if causes else message
        return Gait(problem=problem, dynamics=dynamics, status=status, message=message, solver=solver, causes=causes)
    return _finish(problem, attempt, solver)


def _solver(attempt: Solution[Transcription], began: float) -> dict[str, float]:
    return {"iterations": float(attempt.iterations), "seconds": time.perf_counter() - began}


def _in_order(
    cycle: Cycle,
    dynamics: Dynamics,
    guess: Rollout,
    search: Callable[[Transcription, Array, Array], Solution[Transcription]],
) -> Solution[Transcription]:
    """Search, and again with a new layout while a switch passes a breakpoint of the control."""
    rolled, breakpoints = guess, dynamics.system.control.breakpoints
    for _ in range(MAX_REORDERS):
        durations = np.array(rolled.durations)
        plan = layout(cycle, durations, breakpoints)
        transcription = transcribe(dynamics.system, plan)
        attempt = search(transcription, transcription.pack(rolled.nodes(plan), durations), dynamics.p)
        if attempt.status is not Status.CONVERGED:
            break
        durations = transcription.unpack(attempt.w).durations
        if plan.in_order(durations, breakpoints):
            break
        rolled = roll_out(dynamics, cycle, attempt.w[: dynamics.system.n_z], durations)
    return attempt


def _by_ipopt(
    transcription: Transcription,
    start: Array,
    p: Array,
    *,
    progress: Progress | None = None,
    should_stop: Stop = None,
    relaxed: bool = False,
) -> Solution[Transcription]:
    """Run IPOPT; ``relaxed`` leaves the margins out."""
    program = Feasibility(transcription, progress=progress, should_stop=should_stop, relaxed=relaxed)
    result = program.solve(start, p)
    return Solution(
        transcription, result.w, p, status=result.status, words=result.words, iterations=result.iterations, start=start
    )


def _finish(problem: Problem, attempt: Solution[Transcription], solver: dict[str, float]) -> Gait:
    """Polish, refine until the integration error is small, and assemble the gait."""
    refined = refine(polish(attempt.transcription, attempt.w, attempt.p))
    wrong = rejection_reason(refined)
    if wrong:
        return Gait(
            problem=problem,
            dynamics=Dynamics(attempt.transcription.system, attempt.p),
            status=Status.NOT_CONVERGED,
            message=in_words(wrong),
            solver=solver,
            causes=wrong,
        )
    return assembled(problem, refined, message=attempt.words, solver=solver)


def assembled(problem: Problem, refined: Solution[Transcription], *, message: str, solver: dict[str, float]) -> Gait:
    """The gait at a solution; its message says if the cycle is a shorter one walked several times."""
    gait = assemble_gait(problem, refined, errors=refined.errors, message=message, solver=solver)
    repetition = _repetition(gait)
    return replace(gait, message=f"{gait.message}; {repetition}") if repetition else gait


def _repetition(gait: Gait) -> str:
    """That a cycle is a shorter one walked several times; nothing for any other."""
    n, shorter = len(gait.steps), gait.repeats_after
    words = "every step" if shorter == 1 else f"{shorter} steps"
    return f"the cycle of {n} steps repeats itself after {words}" if shorter < n else ""


@overflow_allowed()
def rejection_reason(refined: Solution[Transcription]) -> tuple[Cause, ...]:
    """What keeps a solution of the equations from being a gait; empty for a gait."""
    transcription, at = refined.transcription, refined
    _, durations, _ = transcription.unpack(at.w)
    short = np.flatnonzero(durations < VANISHING * durations.sum())
    if short.size:
        return (vanished(transcription.layout.cycle, int(short[0]), float(durations[short[0]])),)
    if not np.isfinite(refined.errors).all():
        words = "the equations are singular there: the gait is not isolated, or its motion breaks down"
        return (Cause(what="equations", words=words),)
    if not at.size <= RESIDUAL_TOLERANCE:
        return (Cause(what="equations", words=f"the equations are only met to {at.size:.2g}"),)
    if not refined.accurate:
        intervals = transcription.layout.intervals
        words = f"the integration is only right to {refined.errors.max():.2g}, even with {intervals} intervals"
        return (Cause(what="integration", words=words),)
    violated = violations(transcription, at.w, at.p, transcription.margin_values(at.w, at.p), RESIDUAL_TOLERANCE)
    early = None if violated else early_event(transcription, at.w, at.p)
    return tuple(violated) if early is None else (early,)


def vanished(cycle: Cycle, phase: int, duration: float) -> Cause:
    """That a phase shrinks to nothing."""
    words = f"phase {phase + 1} ({cycle.phases[phase]}) shrinks to nothing: here the gait does without it"
    return Cause(what="duration", words=words, phase=phase, needed=0.0, available=duration)


@overflow_allowed()
def _causes(attempt: Solution[Transcription], guess: Rollout) -> tuple[Cause, ...]:
    """The worst violation: of margins, by a periodic motion solved with or without them, or else of the equations.

    A reference that ends before the step explains more than what motions beyond it violate.
    """
    transcription, p, missing = attempt.transcription, attempt.p, None
    if guess.endless is not None:
        missing = missing_event(transcription.layout.cycle, guess.endless, transcription.system.control)
        if missing.what == "reference":
            return (missing,)
    relaxed = _by_ipopt(transcription, attempt.w if attempt.start is None else attempt.start, p, relaxed=True)
    for w in (relaxed.w, attempt.w):
        residual = transcription.violation(w, p)
        if np.abs(residual / transcription.units(p).equalities).max() <= RESIDUAL_TOLERANCE:
            violated = violations(transcription, w, p, transcription.margin_values(w, p), RESIDUAL_TOLERANCE)
            if violated:
                return tuple(violated)
    return (missing or largest_residual(transcription, attempt.w, p, residual),)
