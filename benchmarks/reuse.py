"""Building the NLP anew for every friction against building it once."""

import time

import numpy as np
from timing import Row

from gaitopt import load_problem, solve
from gaitopt.nlp import Family

REBUILT = 10
"""Values for which it is built anew; one takes as long as another."""
REUSED = 100


def rows() -> list[Row]:
    """Seconds per gait over a range of friction."""
    problem = load_problem("compass-passive-a")
    problems = [problem.replace({"friction": mu}) for mu in np.linspace(0.14, 0.16, REUSED)]
    began = time.perf_counter()
    rebuilt = [solve(p) for p in problems[:: REUSED // REBUILT]]
    each = (time.perf_counter() - began) / len(rebuilt)
    began = time.perf_counter()
    family = Family(rebuilt[0])
    reused = [family.solve(p) for p in problems]
    once = (time.perf_counter() - began) / REUSED
    worst = max(np.abs(a.state - b.state).max() for a, b in zip(rebuilt, reused[:: REUSED // REBUILT], strict=True))
    assert all(gait.converged for gait in (*rebuilt, *reused)), "a gait was lost"
    what = f"a gait at each of {REUSED} frictions"
    note = f"{1 / once:.0f} gaits a second, states within {worst:.0e}"
    return [
        Row(what=what, way="NLP built for each", seconds=each, ratio=1.0, note=f"{REBUILT} of them"),
        Row(what=what, way="NLP built once (Family)", seconds=once, ratio=each / once, note=note),
    ]
