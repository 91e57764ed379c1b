"""A gait for every friction from its own guess, and by chords from the one before."""

import time

import numpy as np
from timing import Row

from gaitopt import Family, Gait, Problem, load_problem, solve
from gaitopt.solver.shooting import condition_derivatives, conditions, transcribe

REBUILT = 10
"""Values for which it is built anew; one takes as long as another."""
REUSED = 100


def rows() -> list[Row]:
    """Seconds per gait over a range of friction."""
    problem = load_problem("compass-passive-a")
    problems = [problem.replace({"friction": mu}) for mu in np.linspace(0.14, 0.16, REUSED)]
    began = time.process_time()
    rebuilt = [solve(p) for p in problems[:: REUSED // REBUILT]]
    each = (time.process_time() - began) / len(rebuilt)
    began = time.process_time()
    family = Family(rebuilt[0])
    reused = [family.solve(p) for p in problems]
    once = (time.process_time() - began) / REUSED
    worst = max(np.abs(a.state - b.state).max() for a, b in zip(rebuilt, reused[:: REUSED // REBUILT], strict=True))
    assert all(gait.converged for gait in (*rebuilt, *reused)), "a gait was lost"
    what = f"a gait at each of {REUSED} frictions"
    note = f"{1 / once:.0f} gaits a second, states within {worst:.0e}"
    return [
        Row(what=what, way="solve for each", seconds=each, ratio=1.0, note=f"{REBUILT} of them"),
        Row(what=what, way="Family", seconds=once, ratio=each / once, note=note),
    ]


def solve_anew(problem: Problem) -> Gait:
    """Solve with nothing kept of its mesh, as the first problem of its kind is."""
    for kept in (transcribe, conditions, condition_derivatives):
        kept.cache_clear()
    return solve(problem)
