"""The gait of a problem with a given mode sequence; the reference of a PD law is solved first."""

from collections.abc import Callable

from gaitopt.gait import Gait
from gaitopt.nlp import find_gait
from gaitopt.problem import Problem
from gaitopt.study.system import build_system


def solve_sequence(
    problem: Problem,
    *,
    start: Gait | None = None,
    progress: Callable[[int, float], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Gait:
    """Solve a problem whose mode sequence is given, with the arguments and errors of ``gaitopt.solve``."""
    system = build_system(problem, should_stop=should_stop) if start is None else start.system
    return find_gait(problem, system, start=start, progress=progress, should_stop=should_stop)
