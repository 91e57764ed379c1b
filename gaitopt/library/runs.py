"""Sweeps, basins, fronts and many starts, as the library offers them: with progress, kept in a run folder.

What is finished is never computed again: a call that was interrupted resumes where it stopped. ``progress`` is as for
``solve``.
"""

from collections.abc import Mapping
from pathlib import Path

from gaitopt.errors import ProblemError
from gaitopt.gait import Gait
from gaitopt.library.progress import Counter, job_progress, shown
from gaitopt.problem import Problem
from gaitopt.runs import multistart as starts_run
from gaitopt.runs.basin_run import BasinPlan, check_basin, walk_basin
from gaitopt.runs.basin_tiles import Basin
from gaitopt.runs.front import Front, design_front
from gaitopt.runs.grid import Grid, axis_of
from gaitopt.runs.sweep import SweepPlan, check_sweep, run_sweep
from gaitopt.runs.sweep_table import Sweep
from gaitopt.store import run_folder
from gaitopt.workers.jobs import make_workers

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
    return run_folder(problem) if output is None else Path(output)
