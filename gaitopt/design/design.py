"""Where parameters are unknowns: the best gait that meets the constraints.

A design starts from a gait: a given one, or that of the guessed parameters. From there IPOPT looks for the optimum of a
smoothed problem over nodes, durations and freed parameters (``program``). Sequential quadratic programming in the freed
parameters alone goes on to that of the exact problem, as the gait is measured (``reduced``, ``sqp``).

Where a design starts: from the motion rolled out from its guess, or from a gait that is known.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.design.program import Program, conflicts
from gaitopt.design.quadratic import SMALL, freed_sizes
from gaitopt.design.rows import RADIUS
from gaitopt.design.sqp import Reduced, optimise
from gaitopt.gait import curves
from gaitopt.gait.gait import Cause, Gait, Status, in_words
from gaitopt.gait.trajectory import Step
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.system import HybridSystem
from gaitopt.nlp.assembly import assemble_gait
from gaitopt.nlp.ipopt import Progress
from gaitopt.nlp.layout import Layout, layout
from gaitopt.nlp.newton import polish, refine
from gaitopt.nlp.rollout import Rollout, roll_out
from gaitopt.nlp.shooting import MultipleShooting
from gaitopt.nlp.solve import free_parameters, rejection_reason
from gaitopt.problem.problem import Problem


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


def guessed(problem: Problem, system: HybridSystem) -> Start:
    """The motion rolled out from the guess, which does not close."""
    dynamics = Dynamics(system, system.values(problem.parameters))
    state = np.array([problem.guess.state[name] for name in system.state_names])
    rolled = roll_out(dynamics, problem.cycle, state, problem.guess.durations)
    free = free_parameters(problem, system)
    freed = np.array([dynamics.parameter(name) for name in free])
    return Start(durations=np.array(rolled.durations), states=rolled_states(rolled), freed=freed)


def rolled_states(rollout: Rollout) -> Callable[[Array], Array]:
    """States of a motion that is rolled out, as a function of times since impact."""
    ends = np.cumsum(rollout.durations)[:-1]

    def states(times: Array) -> Array:
        phases = np.searchsorted(ends, times, side="right")
        return np.hstack([rollout(phase, np.array([t])) for phase, t in zip(phases, times, strict=True)])

    return states


def known(gait: Gait, free: tuple[str, ...]) -> Start:
    """A gait that is known."""
    (step,) = gait.steps
    freed = np.array([gait.dynamics.parameter(name) for name in free])
    return Start(durations=np.array([d for _, d in step.phases]), states=lambda t: step_states(step, t), freed=freed)


def step_states(step: Step, times: Array) -> Array:
    """States (n_z, n) of a step at times since impact (n,)."""
    ends = np.array([arc.end for arc in step.arcs[:-1]])
    columns = []
    for t in times:
        arc = step.arcs[int(np.searchsorted(ends, t, side="right"))]
        s = np.clip(2 * (t - arc.start) / arc.duration - 1, -1, 1)
        columns.append(np.polynomial.chebyshev.chebval(s, curves.coefficients(arc.states)))
    return np.array(columns).T


MAX_ROUNDS = 12
"""Times that a smoothed search may be taken up again where its reach or a breakpoint of the control has stopped it."""
MAX_MESHES = 3
"""Times that an optimum may need a finer mesh than the gait from which it was reached."""
COALESCED = 1e-3
"""Distance of two multipliers, relative to their modulus, at which rounding begins to count by its root."""
CREDITED = 1.2
"""Ratio of absolute to net cost above which a design is said to live on credited negative work."""


def design_gait(
    problem: Problem,
    system: HybridSystem,
    first: Gait,
    *,
    progress: Progress | None = None,
    should_stop: Stop = None,
) -> Gait:
    """The best gait over the freed parameters of ``problem``; arguments as of ``nlp.find_gait``.

    Parameters
    ----------
    first : a gait, or a failed attempt at one, of the same system with the same mode sequence.
    """
    design = _Design(problem, system, progress, should_stop)
    return design.run(known(first, design.free) if first.steps else guessed(problem, system))


class _Design:
    """The searches of one design."""

    def __init__(
        self,
        problem: Problem,
        system: HybridSystem,
        progress: Progress | None,
        should_stop: Stop,
    ) -> None:
        self._problem, self._system = problem, system
        self._progress, self._should_stop = progress, should_stop
        free = free_parameters(problem, system)
        self.free, self._bounds = tuple(free), np.array(list(free.values())).T
        self._dynamics = Dynamics(system, system.values(problem.parameters))

    def run(self, start: Start) -> Gait:
        """Solve the smoothed problem until the search stays where it is, and then the exact one."""
        iterations = 0
        for _ in range(MAX_ROUNDS):
            program = self._program(start)
            result = program.solve()
            iterations += result.iterations
            solver = {"iterations": float(iterations), "kkt": result.kkt, "objective": result.objective}
            if result.status is Status.INTERRUPTED:
                return self._failed(result.status, result.words, solver)
            if result.status is not Status.CONVERGED:
                why = self._conflicts(start)
                message = "\n".join(cause.words for cause in why) or result.words
                return self._failed(Status.INFEASIBLE if why else result.status, message, solver, why)
            durations = program.transcription.unpack(program.motion(result.w)).durations
            if not program.hits_trust_region(result.w) and self._layout(durations).same_arcs(
                program.transcription.layout
            ):
                w = program.motion(result.w)
                gait = self._optimum(program.transcription, w, iterations)
                if gait.status is not Status.NOT_CONVERGED:
                    return gait
                iterations = int(gait.solver.get("iterations", iterations))
                return self._optimum(program.transcription, w, iterations, cautious=True)
            start = self._moved(program, result.w)
        return self._failed(Status.NOT_CONVERGED, "the search does not come to rest", solver)

    def _optimum(self, transcription: MultipleShooting, w: Array, iterations: int, *, cautious: bool = False) -> Gait:
        """The optimum of the exact problem next to a solution of the smoothed one; see ``optimise``."""
        reduced = Reduced(self._problem, self.free, self._bounds)
        refined = refine(polish(transcription, w, self._dynamics.p))
        for _ in range(MAX_MESHES):
            point = reduced.first(refined.transcription, refined.w, self._dynamics.p)
            if point is None:
                lost = rejection_reason(refined)
                message = in_words(lost) or "the gait is lost on a finer mesh"
                return self._failed(Status.NOT_CONVERGED, message, {}, lost)
            freed, levels = np.split(point.u, [len(self.free)])
            sizes = np.concatenate([freed_sizes(freed, self._bounds), np.maximum(np.abs(levels), SMALL)])
            optimum = optimise(
                reduced, point, sizes, cautious=cautious, progress=self._progress, should_stop=self._should_stop
            )
            iterations += optimum.iterations
            s = optimum.point.sensitivity
            refined = refine(s.at)
            if refined.transcription is s.transcription or optimum.interrupted:
                break
        solver = {"iterations": float(iterations), "kkt": optimum.kkt, "objective": optimum.point.objective}
        if optimum.interrupted:
            return self._failed(Status.INTERRUPTED, "interrupted", solver)
        wrong = rejection_reason(refined)
        if wrong or optimum.shortcoming:
            message = in_words(wrong) or str(optimum.shortcoming)
            return self._failed(Status.NOT_CONVERGED, message, solver, wrong)
        gait = assemble_gait(self._problem, refined, errors=refined.errors, message="", solver=solver)
        return replace(gait, message=_verdict(gait))

    def _conflicts(self, start: Start) -> tuple[Cause, ...]:
        """Which constraints cannot be met, by repeated elastic searches from the start."""
        if not self._problem.constraints:
            return ()
        for _ in range(MAX_ROUNDS):
            program = self._program(start, elastic=True)
            result = program.solve()
            if result.status is not Status.CONVERGED or not program.hits_trust_region(result.w):
                break
            start = self._moved(program, result.w)
        return conflicts(self._problem, program, result)

    def _program(self, start: Start, *, elastic: bool = False) -> Program:
        """The smoothed NLP with its nodes on the starting motion, on a coarse mesh."""
        plan = self._layout(start.durations)
        transcription = MultipleShooting(self._system, plan, self.free)
        times = plan.node_times(start.durations)
        w = transcription.pack(start.states(times), start.durations, np.clip(start.freed, *self._bounds))
        return Program(
            self._problem,
            transcription,
            bounds=self._bounds,
            w=w,
            p=self._dynamics.p,
            elastic=elastic,
            progress=self._progress,
            should_stop=self._should_stop,
        )

    def _layout(self, durations: Array) -> Layout:
        return layout(self._problem.cycle, durations, self._system.control.breakpoints)

    def _moved(self, program: Program, x: Array) -> Start:
        """A solution whose switches have passed a breakpoint, to be cut into arcs again."""
        t = program.transcription
        nodes, durations, freed = t.unpack(program.motion(x))
        rolled = roll_out(t.dynamics(self._dynamics.p, freed), self._problem.cycle, nodes[:, 0], list(durations))
        return Start(durations=durations, states=rolled_states(rolled), freed=freed)

    def _failed(self, status: Status, words: str, solver: dict[str, float], causes: tuple[Cause, ...] = ()) -> Gait:
        return Gait(
            problem=self._problem,
            dynamics=self._dynamics,
            status=status,
            message=words,
            solver=solver,
            causes=causes,
        )


def _verdict(gait: Gait) -> str:
    """That it is solved, and what should be known about the cost and the radius."""
    words, problem = ["solved"], gait.problem
    net, absolute = gait.measures["cost_of_transport"], gait.measures["absolute_cost_of_transport"]
    concerned = {*problem.objective, *problem.constraints}
    by_net = bool({"cost_of_transport", "work"} & concerned)
    if by_net and net is not None and absolute is not None and absolute > CREDITED * abs(net):
        words.append(f"the net cost {net:.4g} credits negative work, the absolute cost is {absolute:.4g}")
    if RADIUS in concerned and _coalesce(gait.multipliers):
        words.append("multipliers at the radius coalesce, where it is not a Lipschitz function of the parameters")
    return "; ".join(words)


def _coalesce(multipliers: NDArray[np.complex128]) -> bool:
    """Whether a multiplier of the largest modulus has another one next to it."""
    distances = np.sort(np.abs(multipliers - multipliers[0]))
    return bool(distances.size > 1 and distances[1] < COALESCED * abs(multipliers[0]))
