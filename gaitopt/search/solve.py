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
    """Solve a problem for its gait; the reference of a PD law is solved first.

    Where the mode sequence is open, the gait is the stable one of those that ``find`` lists (the one nearest to the
    guess if there is one), else the least unstable; of a design the one with the best objective.

    Parameters
    ----------
    problem : from ``load_problem``; where parameters are free it is a design, the best gait that meets its constraints.
        Or an attractor of a basin: its cycle, with the modes that the simulator sees, becomes a gait.
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
    if isinstance(problem, Attractor):
        return solve_attractor(problem, progress=progress, should_stop=should_stop)
    if problem.is_open:
        from gaitopt.search.find import find_best  # the search among mode sequences, which most problems do without

        return find_best(problem, progress=progress, should_stop=should_stop)
    return solve_sequence(problem, start=start, progress=progress, should_stop=should_stop)
