"""Build once, solve many: the gaits of one mode sequence at other parameter values, by one NLP.

Near the last gait the equations are solved by chords, w - J^-1 residual with the J of that gait, and checked for
violated margins afterwards; where that does not converge, or finds no gait, IPOPT takes over. Where parameters go on
along a line, the chords start from the polynomial through the last solutions on it.
"""

import threading
import time
from collections import deque
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.gait import Cause, Gait, Status, in_words
from gaitopt.iteration import iterate, overflow_allowed
from gaitopt.mechanics import Dynamics
from gaitopt.nlp.assembly import assemble_gait
from gaitopt.nlp.feasibility import Feasibility
from gaitopt.nlp.layout import layout
from gaitopt.nlp.multiple_shooting import MultipleShooting, transcribe
from gaitopt.nlp.newton import Solution, extrapolation, polish, refine
from gaitopt.nlp.solve import rejection_reason
from gaitopt.problem import Problem

MAX_CHORDS = 10
"""Chords that are tried; from a gait nearby four to six are enough."""
CONTRACTION = 0.5
"""Least decrease of the residual from chord to chord; with less, Newton's method is cheaper."""
REMEMBERED = 5
"""Solutions on a line that are extrapolated from: with more, what rounding adds is as much as what is left out."""
STRAIGHT = 1e-9
"""Distance from a line, relative to the distance along it, that is rounding."""
SETTLED = 1e-12
"""Residual in natural units at which the last chord has reached rounding."""


class Family:
    """The NLP on the layout of a gait; every solution starts from the last one, so that threads take turns.

    Parameters
    ----------
    gait : a converged gait without freed parameters, the first of the family.
    should_stop : polled at every iteration; True ends the search with the status ``interrupted``.

    Raises
    ------
    ValueError
        If ``gait`` is a failed attempt, or a design.
    """

    def __init__(self, gait: Gait, *, should_stop: Stop = None) -> None:
        if not gait.steps or gait.shooting is None or gait.freed:
            raise ValueError(f"{gait.problem.name}: a family begins with a converged gait without freed parameters")
        self.gait, self._system = gait, gait.system
        durations = [duration for _, duration in gait.phases]
        plan = layout(gait.problem.cycle, durations, gait.system.control.breakpoints)
        self._transcription = transcribe(gait.system, plan.refined(list(gait.shooting.intervals)))
        self._should_stop, self._solving = should_stop, threading.RLock()
        self._w = self._transcription.pack(gait.shooting.states.T, np.array(durations))
        self._jacobian = Solution(self._transcription, self._w, gait.p).scaled
        self._solved = deque([(gait.p, self._w)], maxlen=REMEMBERED)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies and pickles go on from the same solutions; ``should_stop`` stays behind."""
        return _resumed, (self.gait, tuple(self._solved))

    @cached_property
    def _program(self) -> Feasibility:
        return Feasibility(self._transcription, should_stop=self._should_stop)

    def solve(self, problem: Problem) -> Gait:
        """The gait of ``problem``, which differs from the first one in parameter values alone.

        Raises
        ------
        ValueError
            If its walker, kind of control, impact law or mode sequence is another one.
        """
        first = self.gait.problem
        same = (problem.cycle, problem.impact_law, type(problem.walker)) == (
            first.cycle, first.impact_law, type(first.walker)
        )  # fmt: skip
        if not same or problem.reference != first.reference or tuple(problem.parameters) != tuple(first.parameters):
            raise ValueError(f"{problem.name} differs from {first.name} in more than parameter values: use solve")
        with self._solving:
            return self._solved_from_last(problem)

    def _solved_from_last(self, problem: Problem) -> Gait:
        began = time.perf_counter()
        dynamics = Dynamics(self._system, self._system.values(problem.parameters))
        p = dynamics.p
        refined, wrong, iterations = self._near(p)
        status, message = Status.CONVERGED, "solved"
        if refined is None or wrong:
            result = self._program.solve(self._w, p)
            status, message, iterations = result.status, result.words, iterations + result.iterations
            if status is Status.CONVERGED:
                refined = refine(polish(self._transcription, result.w, p))
                wrong = rejection_reason(refined)
                status, message = (Status.NOT_CONVERGED, in_words(wrong)) if wrong else (status, message)
        solver = {"iterations": float(iterations), "seconds": time.perf_counter() - began}
        if refined is None or status is not Status.CONVERGED:
            return Gait(problem=problem, dynamics=dynamics, status=status, message=message, solver=solver)
        self._remember(refined)
        return assemble_gait(problem, refined, errors=refined.errors, message=message, solver=solver)

    @overflow_allowed()
    def _near(self, p: Array) -> tuple[Solution[MultipleShooting] | None, tuple[Cause, ...], int]:
        """The solution by chords, what is wrong with it, and their number; no solution if they do not converge."""
        units = self._transcription.units(p).equalities

        def point(w: Array) -> tuple[Array, Array, float]:
            residual = self._transcription.violation(w, p)
            return w, residual, float(np.abs(residual / units).max())

        for start in (self._start(p), self._w):
            end = iterate(
                point(start),
                lambda at: point(at[0] - self._jacobian.solve(at[1])),
                size=lambda at: at[2],
                solved=lambda at: at[2] < SETTLED,
                most=MAX_CHORDS,
                contraction=CONTRACTION,
            )
            if end.solved:
                break
        else:
            return None, (), end.count
        w, residual, _ = end.at
        w = w - self._jacobian.solve(residual)
        refined = refine(polish(self._transcription, w, p))
        return refined, rejection_reason(refined), end.count + 1

    def _remember(self, refined: Solution[MultipleShooting]) -> None:
        """Start the next solution from this one, unless it had to be refined."""
        if refined.transcription is self._transcription:
            self._w, self._jacobian = refined.w, refined.scaled
            self._solved.append((refined.p, refined.w))

    def _start(self, p: Array) -> Array:
        """The solution at ``p`` as extrapolated along a line, or the last one where there is none."""
        last, unit = self._solved[-1][0], np.maximum(np.abs(p), np.finfo(float).tiny)
        ahead = (p - last) / unit
        if not ahead.any():
            return self._w
        places, solutions = [0.0], [self._w]  # the last solution lies at 0, and ``p`` at 1
        for before, w in list(self._solved)[-2::-1]:
            offset = (before - last) / unit
            place = float(offset @ ahead / (ahead @ ahead))
            if np.abs(offset - place * ahead).max() > STRAIGHT * np.abs(offset).max():
                break
            places, solutions = [*places, place], [*solutions, w]
        while (weights := extrapolation(places, 1.0)) is None:
            places, solutions = places[:-1], solutions[:-1]
        return np.asarray(weights @ np.array(solutions))


def _resumed(gait: Gait, solved: Sequence[tuple[Array, Array]]) -> Family:
    """A family that has found these solutions, as pairs of parameters and unknowns."""
    family = Family(gait)
    family._solved = deque(solved, maxlen=REMEMBERED)
    p, family._w = solved[-1]
    family._jacobian = Solution(family._transcription, family._w, p).scaled
    return family
