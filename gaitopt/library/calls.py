"""Solve, continue, find, as the library offers them: with progress.

``progress`` is shown on a terminal and in a notebook; False hides it, and a function is called instead.
"""

from collections.abc import Callable, Mapping, Sequence

from gaitopt.callbacks import Stop
from gaitopt.families import Request, follow_family
from gaitopt.gait import Branch, BranchPoint, Gait, SpecialPoint
from gaitopt.gait.attractor import Attractor
from gaitopt.gait.branch import collected
from gaitopt.library.progress import Counter, Follower, job_progress, shown, solver_progress, value_progress
from gaitopt.problem import Problem
from gaitopt.search.distinct import Gaits
from gaitopt.search.find import STARTS, SearchPlan, in_memory, opened, search
from gaitopt.search.solve import solve as solve_any
from gaitopt.workers.jobs import Workers


def solve(
    problem: Problem | Attractor, *, start: Gait | None = None, progress: Follower = True, should_stop: Stop = None
) -> Gait:
    """Solve a problem for its gait; the reference of a PD law is solved first.

    A problem whose continuous parameters were changed by ``replace`` keeps the gait of its file: that gait is followed
    from the file's values to the new ones. If its family ends on the way, the status is ``infeasible``; the message
    says where, and the causes say what the motion would violate at the new values. The command line, sweeps and
    ``explain`` do the same.
    ``solve(problem.from_guess())`` looks for a gait near the guess instead. So does ``solve`` itself where another
    guess, mode sequence or structure was given, for designs, and where the file's problem has no gait.

    Where the mode sequence is open, the gait is the stable one of those that ``find`` lists (the one nearest to the
    guess if there is one), else the least unstable; of a design the one with the best objective.

    Parameters
    ----------
    problem : from ``load_problem``; where parameters are free it is a design, the best gait that meets its constraints.
        Or an attractor of a basin: its cycle, with the modes that the simulator sees, becomes a gait.
    start : a gait of the same walker, control law and mode sequence from which a design starts instead of the guess.
    progress : whether to show it, or a function of the iteration's number and the largest violation of a constraint.
    should_stop : polled at every iteration; True ends the search with the status ``interrupted``.

    Returns
    -------
    gait : ``gait.status`` says whether it may be trusted; a failure to converge is not an error.

    Raises
    ------
    SolveError
        If the reference of a PD law is not a gait.
    """
    name = problem.problem.name if isinstance(problem, Attractor) else problem.name
    with shown(progress, solver_progress, f"solving {name}") as show:
        return solve_any(problem, start=start, progress=show, should_stop=should_stop)


def continuation(
    start: Gait | SpecialPoint,
    parameter: str,
    to: float | Sequence[float],
    *,
    lower: float | None = None,
    upper: float | None = None,
    events: Mapping[str, Callable[[Gait], float]] | None = None,
    max_points: int = 2000,
    max_seconds: float | None = None,
    verify_every: int = 10,
    doublings: int = 0,
    branch_points: int = 0,
    mode_changes: int = 0,
    progress: Follower = True,
    should_stop: Stop = None,
) -> Branch:
    """Continue a gait in a parameter, through folds and changes of the mode sequence.

    Parameters
    ----------
    start : a converged gait; or a special point of a branch, from which the other branches that begin there are
        continued: at a ``period_doubling`` the cycles of twice as many steps, at a ``branch_point`` both halves of the
        curve that crosses the known one, at a change of modes the mode sequences that were not followed.
    parameter : dotted key of any scalar of walker, friction or control.
    to : value of the parameter towards which to go, and at which to stop; two values to go both ways.
    lower, upper : further bounds of the parameter, for families that turn round.
    events : functions of a gait, continuous along the family: ``{"fast": lambda gait: gait.scalar("speed") - 0.5}``.
        Their zeros are located as precisely as bifurcations, and are special points of that type.
    max_points, max_seconds : limits of the work towards each target; an end at one of them is ``open``.
    verify_every : every so many points is confirmed by the simulator.
    doublings, branch_points, mode_changes : how many times in turn the other branches that begin at such special points
        on the way are followed as well.
    progress : whether to show it, or a function of the number of points and the parameter.
    should_stop : polled before every point.

    Returns
    -------
    branch : points and special points.

    Raises
    ------
    UnknownNameError
        If there is no such parameter; the message lists the near misses.
    ProblemError
        If a target lies beyond a bound, or no other branch can begin at such a special point.
    SolveError
        If ``start`` is a failed attempt, or no other branch is found at it.
    """
    request = Request(
        parameter=parameter,
        to=(float(to),) if isinstance(to, int | float) else tuple(map(float, to)),
        lower=lower,
        upper=upper,
        events=events or {},
        max_points=max_points,
        max_seconds=max_seconds,
        verify_every=verify_every,
        follow={"doublings": doublings, "branch_points": branch_points, "mode_changes": mode_changes},
    )
    records = list[BranchPoint | SpecialPoint]()
    with shown(progress, value_progress, "continuing", parameter) as show:
        for record in follow_family(start, request, should_stop=should_stop):
            records.append(record)
            show(len(records), record.value)
    return collected(parameter, records)


def find(
    problem: Problem,
    *,
    starts: int = STARTS,
    seed: int = 0,
    within: Mapping[str, tuple[float, float]] | None = None,
    workers: int = 1,
    progress: Counter = True,
    should_stop: Stop = None,
) -> Gaits:
    """All gaits at a problem's parameters that two searches lead to, of any mode sequence.

    Parameters
    ----------
    problem : its phases are ignored if it has some; a guess is one of the starts. Where parameters are free, the best
        gait of every mode sequence is listed.
    starts : start states of the search by simulation.
    seed : of the samples.
    within : range of the start states by name of a section coordinate, where it is not to be the walker's default.
    workers : processes.
    progress : whether to show it, or a function of the number of finished parts of the search and their total.
    should_stop : polled; True ends the search with a KeyboardInterrupt.

    Returns
    -------
    gaits : each solved to 1e-10 and verified; stable ones first, then by spectral radius.

    Raises
    ------
    UnknownNameError
        If ``within`` names something that is no section coordinate.
    """
    plan = SearchPlan(problem=opened(problem), starts=starts, seed=seed, within=within or {})
    with shown(progress, job_progress, "parts of the search") as show:
        return search(plan, in_memory(Workers(count=workers), show, should_stop), should_stop=should_stop)
