"""Solve, continue, find, as the library offers them: with progress.

``progress`` is shown on a terminal and in a notebook; False hides it, and a function is called instead.

Long questions as the library offers them, with progress in words: why there is no gait, and whether it is proved.

Sweeps, basins, fronts and many starts, as the library offers them: with progress, kept in a run folder.

What is finished is never computed again: a call that was interrupted resumes where it stopped. ``progress`` is as for
``solve``.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gaitopt.api.progress import (
    Counter,
    Follower,
    Teller,
    job_progress,
    shown,
    solver_progress,
    value_progress,
    word_progress,
)
from gaitopt.branches.continuation import follow_family
from gaitopt.branches.request import Request
from gaitopt.callbacks import Stop
from gaitopt.errors import ProblemError
from gaitopt.gait.branch import Branch, BranchPoint, SpecialPoint, collected
from gaitopt.gait.gait import Attractor, Gait
from gaitopt.problem.problem import Problem
from gaitopt.runs import multistart as starts_run
from gaitopt.runs.basin import Basin, BasinPlan, check_basin, walk_basin
from gaitopt.runs.front import Front, design_front
from gaitopt.runs.grid import Grid, axis_of
from gaitopt.runs.sweep import Sweep, SweepPlan, check_sweep, run_sweep
from gaitopt.search.explain import Explanation
from gaitopt.search.explain import explain as explain_problem
from gaitopt.search.find import STARTS, Gaits, SearchPlan, in_memory, opened, search
from gaitopt.search.solve import solve as solve_any
from gaitopt.store.run import Run
from gaitopt.workers.jobs import Workers, make_workers

if TYPE_CHECKING:
    from gaitopt.proof.theorem import Proof


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


def explain(
    problem: Problem,
    *,
    starts: int = STARTS,
    seed: int = 0,
    workers: int = 1,
    progress: Teller = True,
    should_stop: Stop = None,
) -> Explanation:
    """Why a problem has no gait: the violated conditions, what happens instead, and where the gait begins to exist.

    Parameters
    ----------
    starts, seed, workers : of the search for gaits of other mode sequences, see ``find``.
    progress : whether to show it, or a function of what is done next in words.
    should_stop : polled at every iteration.

    Raises
    ------
    KeyboardInterrupt
        If ``should_stop`` said so.
    """
    with shown(progress, word_progress, f"explaining {problem.name}") as say:
        return explain_problem(
            problem, starts=starts, seed=seed, workers=workers, progress=say, should_stop=should_stop
        )


def prove(gait: Gait, intervals: Mapping[str, str] | None = None, *, progress: Teller = True) -> "Proof":
    """Prove that a gait exists, is locally unique, has its mode sequence, and is stable or unstable.

    Parameters
    ----------
    gait : converged; nothing of it is trusted.
    intervals : parameters by dotted key for all of whose values this is to be proved, as ``0.18..0.25``. One with
        which the orbit moves is covered by boxes that follow the orbit.
    progress : whether to show it, or a function of how far the search is in words.

    Raises
    ------
    UnknownNameError
        If a key is no parameter of the gait.
    ValueError
        If an interval is not of that form.
    """
    from gaitopt.proof.prove import prove as prove_gait  # which needs the extra

    with shown(progress, word_progress, f"proving {gait.problem.name}") as say:
        return prove_gait(gait, intervals, progress=say)


Over = Mapping[str, tuple[float | str, float | str, int]]
"""Lower and upper end and number of values of each dotted key; angles may be texts such as ``"2 deg"``."""


def sweep(
    problem: Problem,
    over: Over,
    *,
    warm: bool = False,
    from_guess: bool = False,
    workers: int | None = None,
    output: str | Path | None = None,
    progress: Counter = True,
) -> Sweep:
    """Solve and verify a problem over a grid of its parameters; the result at a point is that of ``solve``.

    What is solved is kept in the run folder and never solved again; an interrupted call resumes where it stopped.

    Parameters
    ----------
    over : lower end, upper end and number of values by dotted key: ``{"friction": (0.1, 0.3, 20)}``.
    warm : start each point from the gait of its neighbour instead, and solve it as ``solve`` where that fails. The
        result may then depend on the grid.
    from_guess : solve each point from the problem's guess instead, as ``solve(problem.from_guess())``.
    workers : processes; by default one per core.
    output : the run folder, by default ``results/NAME-HASH``.
    progress : whether to show it, or a function of the number of points done and their total.

    Raises
    ------
    UnknownNameError
        If the grid is over something that is not a parameter.
    ProblemError
        If a range is empty, or a point of the grid is no valid problem.
    StorageError
        If the folder cannot be written, or the grid does not fit.
    """
    plan = SweepPlan(
        problem=problem, grid=_grid(over), warm=warm, folder=_folder(problem, output), from_guess=from_guess
    )
    check_sweep(plan)
    with shown(progress, job_progress, "jobs") as show:
        return run_sweep(plan, make_workers(workers, None), progress=show)


def basin(
    start: Gait | Problem,
    over: Over,
    *,
    steps: int = 100,
    engine: str = "auto",
    workers: int | None = None,
    output: str | Path | None = None,
    progress: Counter = True,
) -> Basin:
    """Walk from every state of a grid until it settles on a gait or fails.

    Parameters
    ----------
    start : gait, or problem with a guess, whose state gives the coordinates that the grid does not vary.
    over : lower end, upper end and number of values by coordinate: ``{"theta1": ("-12 deg", "-6 deg", 50)}``.
    steps : steps after which a state is undecided.
    engine : ``auto``, ``scipy`` or ``heyoka``.
    workers, output, progress : as for ``sweep``.

    Raises
    ------
    UnknownNameError, ProblemError, StorageError
        As for ``sweep``.
    """
    problem = start.problem if isinstance(start, Gait) else start
    folder = _folder(problem, output)
    plan = BasinPlan.around(start, _grid(over), max_steps=steps, engine=engine, folder=folder)
    check_basin(plan)
    with shown(progress, job_progress, "tiles") as show:
        return walk_basin(plan, make_workers(workers, None), progress=show)


def front(problem: Problem, over: Over, *, output: str | Path | None = None, progress: Counter = True) -> Front:
    """Design along one number of a problem, in both directions, and mark the Pareto front.

    Parameters
    ----------
    problem : a design with an objective.
    over : one key with its range, for instance ``{"constraints.speed.min": (0.3, 0.5, 9)}``.
    output, progress : as for ``sweep``.

    Raises
    ------
    ProblemError
        If the problem has no objective, a value is wrong for it, or there is more than one key.
    StorageError
        As for ``sweep``.
    """
    axes = _grid(over).axes
    if len(axes) != 1:
        raise ProblemError("a front runs along one key")
    with shown(progress, job_progress, "designs") as show:
        return design_front(problem, axes[0], _folder(problem, output), progress=show)


def multistart(
    problem: Problem,
    starts: int,
    *,
    seed: int = 0,
    spread: float = 0.3,
    workers: int | None = None,
    output: str | Path | None = None,
    progress: Counter = True,
) -> list[starts_run.Optimum]:
    """Distinct solutions from the problem's own guess and ``starts - 1`` sampled ones, the best verified one first.

    Parameters
    ----------
    problem : a design, or a problem without unknowns (then its distinct gaits are found).
    seed : of the samples.
    spread : how far a sample goes: coordinates and freed numbers by this part of themselves, control points of a curve
        by this part of the curve's range, all within their bounds.
    workers, output, progress : as for ``sweep``.

    Raises
    ------
    StorageError
        As for ``sweep``.
    """
    folder, jobs_at = _folder(problem, output), make_workers(workers, None)
    with shown(progress, job_progress, "starts") as show:
        return starts_run.multistart(problem, starts, folder, seed=seed, spread=spread, workers=jobs_at, progress=show)


def _grid(over: Over) -> Grid:
    try:
        return Grid(tuple(axis_of(key, *span) for key, span in over.items()))
    except (TypeError, ValueError) as error:
        raise ProblemError(
            f"over: {error}; write {{KEY: (LO, HI, N)}}, for instance {{'friction': (0.1, 0.3, 20)}}"
        ) from error


def _folder(problem: Problem, output: str | Path | None) -> Path:
    return Run.of(problem, output).folder
