"""The gait that a problem asks for; where parameters are unknowns, the best one that meets the constraints.

A design starts from a gait: a given one, or that of the guessed parameters. It is solved on a coarse mesh, refined,
measured by the same yardstick as every other gait, and solved again with what the mesh has missed (offsets of the
scalars, margins between the nodes) until nothing is missed.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gaitopt.gait import Cause, Gait, Status, Step, curves, in_words
from gaitopt.mechanics import HybridSystem
from gaitopt.nlp.assembly import assemble_gait
from gaitopt.nlp.between import Touch, touches
from gaitopt.nlp.conflict import conflicts
from gaitopt.nlp.ipopt import Progress
from gaitopt.nlp.layout import Layout, layout
from gaitopt.nlp.newton import polish
from gaitopt.nlp.program import RADIUS, Program
from gaitopt.nlp.refinement import refine
from gaitopt.nlp.rollout import Rollout, roll_out
from gaitopt.nlp.solve import solve_gait, trouble
from gaitopt.nlp.transcription import Transcription
from gaitopt.problem import Problem

Array = NDArray[np.float64]

MAX_ROUNDS = 12
SETTLED = 1e-8
"""Change of every scalar's offset from round to round, relative to the scalar or to one."""
TOUCHED = 1e-11
"""A margin below minus this between the nodes is held there in the next round; it is well above rounding."""
CREDITED = 1.2
"""Ratio of absolute to net cost above which a design is said to live on credited negative work."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """Where a design starts.

    Attributes
    ----------
    durations : ndarray, shape (n_phases,) - [s].
    states : from times since impact (n,) to states (n_z, n).
    freed : ndarray, shape (n_free,) - values of the freed parameters.
    """

    durations: Array
    states: Callable[[Array], Array]
    freed: Array


def free_parameters(problem: Problem, system: HybridSystem) -> dict[str, tuple[float, float]]:
    """Bounds of all unknown parameters by dotted key: those of the file, and those of the control law itself."""
    asked = {key: (free.lower, free.upper) for key, free in problem.free.items()}
    return asked | {f"control.{name}": bounds for name, bounds in system.control.unknowns.items()}


def find_gait(
    problem: Problem,
    system: HybridSystem,
    *,
    start: Gait | None = None,
    progress: Progress | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Gait:
    """The gait that ``problem`` asks for: designed where parameters are unknowns, solved otherwise.

    Parameters
    ----------
    start : a gait of the same system with the same mode sequence from which a design starts instead of the guess.
    progress : called at every iteration with its number and the largest violation.
    should_stop : polled at every iteration; True ends the search with the status ``interrupted``.
    """
    if not free_parameters(problem, system):
        return solve_gait(problem, system, progress=progress, should_stop=should_stop)
    began = time.perf_counter()
    first = start or solve_gait(problem, system, progress=progress, should_stop=should_stop)
    if first.status is Status.INTERRUPTED:
        return first
    design = _Design(problem, system, progress, should_stop)
    gait = design.run(_guess(problem, system) if not first.steps else _warm(first, design.free))
    return replace(gait, solver={**gait.solver, "seconds": time.perf_counter() - began})


class _Design:
    """Rounds of one design."""

    def __init__(
        self,
        problem: Problem,
        system: HybridSystem,
        progress: Progress | None,
        should_stop: Callable[[], bool] | None,
    ) -> None:
        self._problem, self._system = problem, system
        self._progress, self._should_stop = progress, should_stop
        free = free_parameters(problem, system)
        self.free, self._bounds = tuple(free), np.array(list(free.values())).T
        self._p = system.values(problem.parameters)

    def run(self, start: Start) -> Gait:
        """Solve, refine, measure, until nothing is missed."""
        held: list[Touch] = []
        program = self._program(start, held)
        offsets, x = np.zeros(len(program.names)), None
        iterations = 0
        for _ in range(MAX_ROUNDS):
            result = program.solve(offsets, x)
            iterations += result.iterations
            solver = {"iterations": float(iterations), "kkt": result.kkt, "objective": result.objective}
            if result.status is Status.INTERRUPTED:
                return self._failed(result.status, result.words, solver)
            if result.status is not Status.CONVERGED:
                why = self._conflicts(start, offsets)
                message = "\n".join(cause.words for cause in why) or result.words
                return self._failed(Status.INFEASIBLE if why else result.status, message, solver, why)
            durations = program.transcription.unpack(program.motion(result.w))[1]
            if program.at_reach(result.w) or not self._layout(durations).same_arcs(program.transcription.layout):
                program, held, x = self._program(self._moved(program, result.w), []), [], None
                continue
            refined = refine(program.transcription, polish(program.transcription, program.motion(result.w), self._p).at)
            gait = assemble_gait(
                self._problem, refined.transcription, refined.at, errors=refined.errors, message="", solver=solver
            )
            missed = touches(gait, TOUCHED)
            measured = offsets + _scalars(gait, program.names) - program.values(result.w, offsets)
            settled = np.abs(measured - offsets) <= SETTLED * np.maximum(1.0, np.abs(measured))
            wrong, finer = trouble(refined), refined.transcription.layout
            if settled.all() and not missed and (not wrong or program.transcription.layout == finer):
                break
            offsets, x = measured, result.w
            if missed or wrong:  # a margin at its edge, where the coarse mesh is a little off
                held = [*held, *missed]
                plan = finer if wrong else program.transcription.layout
                program, x = self._program(_warm(gait, self.free), held, plan=plan), None
        if wrong:
            return self._failed(Status.NOT_CONVERGED, in_words(wrong), solver, wrong)
        return replace(gait, message=_verdict(gait))

    def _conflicts(self, start: Start, offsets: Array) -> tuple[Cause, ...]:
        """Which constraints cannot be met, found from the start in as many searches as it takes."""
        if not self._problem.constraints:
            return ()
        for _ in range(MAX_ROUNDS):
            program = self._program(start, [], elastic=True)
            result = program.solve(offsets)
            if result.status is not Status.CONVERGED or not program.at_reach(result.w):
                break
            start = self._moved(program, result.w)
        return conflicts(self._problem, program, result, offsets)

    def _program(
        self, start: Start, held: list[Touch], *, elastic: bool = False, plan: Layout | None = None
    ) -> Program:
        """The NLP with its nodes on the starting motion, on a coarse mesh unless a plan is given."""
        plan = plan or self._layout(start.durations)
        transcription = Transcription(self._system, plan, self.free)
        times = plan.node_times(start.durations)
        w = transcription.pack(start.states(times), start.durations, np.clip(start.freed, *self._bounds))
        return Program(
            self._problem,
            transcription,
            bounds=self._bounds,
            w=w,
            p=self._p,
            held=held,
            elastic=elastic,
            progress=self._progress,
            should_stop=self._should_stop,
        )

    def _layout(self, durations: Array) -> Layout:
        return layout(self._problem.cycle, durations, self._system.control.breakpoints)

    def _moved(self, program: Program, x: Array) -> Start:
        """A solution whose switches have passed a breakpoint, to be cut anew."""
        t = program.transcription
        nodes, durations, freed = t.unpack(program.motion(x))
        rolled = roll_out(
            self._system, t.full_parameters(self._p, freed), self._problem.cycle, nodes[:, 0], list(durations)
        )
        return Start(durations=durations, states=_rolled(rolled), freed=freed)

    def _failed(self, status: Status, words: str, solver: dict[str, float], causes: tuple[Cause, ...] = ()) -> Gait:
        return Gait(
            problem=self._problem,
            system=self._system,
            p=self._p,
            status=status,
            message=words,
            solver=solver,
            causes=causes,
        )


def _guess(problem: Problem, system: HybridSystem) -> Start:
    """The motion rolled out from the guess, which does not close."""
    p = system.values(problem.parameters)
    state = np.array([problem.guess.state[name] for name in system.state_names])
    rolled = roll_out(system, p, problem.cycle, state, problem.guess.durations)
    free = free_parameters(problem, system)
    freed = np.array([p[system.parameters.index(name)] for name in free])
    return Start(durations=np.array(rolled.durations), states=_rolled(rolled), freed=freed)


def _rolled(rollout: Rollout) -> Callable[[Array], Array]:
    ends = np.cumsum(rollout.durations)[:-1]

    def states(times: Array) -> Array:
        phases = np.searchsorted(ends, times, side="right")
        return np.hstack([rollout(phase, np.array([t])) for phase, t in zip(phases, times, strict=True)])

    return states


def _warm(gait: Gait, free: tuple[str, ...]) -> Start:
    """A gait that is known."""
    (step,) = gait.steps
    freed = np.array([gait.p[gait.system.parameters.index(name)] for name in free])
    return Start(durations=np.array([d for _, d in step.phases]), states=lambda t: _states(step, t), freed=freed)


def _states(step: Step, times: Array) -> Array:
    """States (n_z, n) of a step at times since impact (n,)."""
    ends = np.array([arc.end for arc in step.arcs[:-1]])
    columns = []
    for t in times:
        arc = step.arcs[int(np.searchsorted(ends, t, side="right"))]
        s = np.clip(2 * (t - arc.start) / arc.duration - 1, -1, 1)
        columns.append(np.polynomial.chebyshev.chebval(s, curves.coefficients(arc.states)))
    return np.array(columns).T


def _scalars(gait: Gait, names: tuple[str, ...]) -> Array:
    """The exact scalars of a gait; shape (n,)."""
    known = {
        **gait.measures,
        RADIUS: gait.spectral_radius,
        **dict(zip(gait.system.parameters, gait.p, strict=True)),
        **{f"state.{name}": value for name, value in zip(gait.system.state_names, gait.state, strict=True)},
    }
    return np.array([float(known[name]) for name in names])


def _verdict(gait: Gait) -> str:
    """That it is solved, and whether its net cost owes something to negative work."""
    net, absolute = gait.measures["cost_of_transport"], gait.measures["absolute_cost_of_transport"]
    asked = {"cost_of_transport", "work"} & {*gait.problem.objective, *gait.problem.constraints}
    if asked and net is not None and absolute is not None and absolute > CREDITED * abs(net):
        return f"solved; the net cost {net:.4g} credits negative work, the absolute cost is {absolute:.4g}"
    return "solved"
