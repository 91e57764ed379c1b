"""The gait of a problem, whether its mode sequence is given or open."""

from collections.abc import Callable

from gaitopt.gait import Gait
from gaitopt.gait.attractor import Attractor
from gaitopt.problem import Problem
from gaitopt.search.attractor import solve_attractor
from gaitopt.study.solve import solve_sequence


def solve(
    problem: Problem | Attractor,
    *,
    start: Gait | None = None,
    progress: Callable[[int, float], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Gait:
    """As ``gaitopt.solve``; ``progress`` is called with the iteration and the largest violation of a constraint."""
    if isinstance(problem, Attractor):
        return solve_attractor(problem, progress=progress, should_stop=should_stop)
    if problem.is_open:
        from gaitopt.search.find import find_best  # the search among mode sequences, which most problems do without

        return find_best(problem, progress=progress, should_stop=should_stop)
    return solve_sequence(problem, start=start, progress=progress, should_stop=should_stop)
