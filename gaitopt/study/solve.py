"""A problem's gait, whatever it needs first: the reference of a PD law, or a search for the mode sequence."""

from collections.abc import Callable

from gaitopt.gait import Gait
from gaitopt.nlp import find_gait
from gaitopt.problem import Problem
from gaitopt.study.system import build_system


def solve(
    problem: Problem,
    *,
    start: Gait | None = None,
    progress: Callable[[int, float], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Gait:
    """Solve a problem for its gait; the reference of a PD law is solved first.

    Where the mode sequence is open, the gait is the stable one of those that ``find`` lists (the one nearest to the
    guess if there is one), else the least unstable; of a design the one with the best objective.

    Parameters
    ----------
    problem : from ``load_problem``; where parameters are free it is a design, the best gait that meets its constraints.
    start : a gait of the same walker, control law and mode sequence from which a design starts instead of the guess.
    progress : called at every iteration of IPOPT with its number and the largest violation of a constraint.
    should_stop : polled at every iteration; True ends the search with the status ``interrupted``.

    Returns
    -------
    gait : ``gait.status`` says whether it may be trusted; a failure to converge is not an error.

    Raises
    ------
    SolveError
        If the reference of a PD law is not a gait.
    """
    if problem.is_open:
        from gaitopt.study.find import find_best  # which solves its candidates by this very function

        return find_best(problem, progress=progress, should_stop=should_stop)
    system = build_system(problem, should_stop=should_stop) if start is None else start.system
    return find_gait(problem, system, start=start, progress=progress, should_stop=should_stop)
