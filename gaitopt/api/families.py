"""Computations of many gaits or many walks: curves of gaits, grids, basins, atlases, chains of designs, many starts.

Arguments mean the same as in ``gaitopt.api.verbs``. Results are stored in a run folder as soon as they are computed; a
repeated call resumes. ``run_parallel`` calls a function of your own in several processes.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any
from uuid import uuid4

from gaitopt.api.progress import CountProgress, ValueProgress, job_progress, shown, value_progress
from gaitopt.api.verbs import Output, problem_from, solve
from gaitopt.branches.continuation import follow_family
from gaitopt.branches.request import Request
from gaitopt.branches.trace import follow_curve, traced_start
from gaitopt.callbacks import Stop
from gaitopt.display import counted
from gaitopt.errors import ArgumentError, ProblemError
from gaitopt.gait.branch import Branch, BranchPoint, SpecialPoint, collected
from gaitopt.gait.gait import Gait
from gaitopt.gait.trace import CurveStart, Trace, TracePoint, TraceSpecial, collected_trace
from gaitopt.problem.floor import Floor
from gaitopt.problem.problem import Problem
from gaitopt.requests import BasinRequest, Engine, Method, RobustnessRequest, TraceRequest, choice
from gaitopt.runs.atlas import Atlas, AtlasPlan
from gaitopt.runs.attractors import Attractors, AttractorsPlan
from gaitopt.runs.basin import Basin, BasinPlan
from gaitopt.runs.branch import BranchPlan, restore_branch
from gaitopt.runs.front import Front, FrontPlan
from gaitopt.runs.grid import Grid, axis_of
from gaitopt.runs.multistart import Optimum, StartsPlan
from gaitopt.runs.robustness import Robustness, RobustnessPlan, check_question
from gaitopt.runs.sweep import Sweep, SweepPlan
from gaitopt.runs.trace import TracePlan, restore_trace
from gaitopt.store.run import Run
from gaitopt.workers.jobs import Job, make_workers, run_jobs

Over = Mapping[str, tuple[float | str, float | str, int]]
"""Lower and upper end and number of values of each dotted key; angles may be texts such as ``"2 deg"``."""


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
    output: Output = False,
    progress: ValueProgress = True,
    should_stop: Stop = None,
) -> Branch:
    """Continue a gait in a parameter, through folds and changes of the mode sequence.

    Parameters
    ----------
    start : a converged gait; or a special point of a branch, from which the other branches that begin there are
        continued: at a ``period_doubling`` the cycles of twice as many steps, at a ``branch_point`` both halves of the
        curve that crosses the known one, at a change of modes the mode sequences that were not followed. In another
        parameter than that of its branch, the gait at the special point is continued.
    parameter : dotted key of any scalar of walker, friction or control.
    to : target value of the parameter; two values to continue in both directions.
    lower, upper : further bounds of the parameter, for families with folds.
    events : functions of a gait, continuous along the family: ``{"fast": lambda gait: gait.scalar("speed") - 0.5}``.
        Their zeros are located as precisely as bifurcations, and are special points of that type.
    max_points, max_seconds : limits per target; a branch that ends at a limit is ``open``.
    verify_every : verify every N-th point by simulation; 0 for none.
    doublings, branch_points, mode_changes : also follow the branches that begin at such special points, up to this
        number of levels.
    output : run folder in which every point is stored as soon as it is found; points of earlier calls are read from
        it. True for a folder in ``results`` that is named after gait, parameter and targets.
    progress : whether to show it, or a function of the number of points and the parameter.
    should_stop : polled before every point; True ends the branch there, or raises KeyboardInterrupt with ``output``.

    Returns
    -------
    branch : points and special points.

    Raises
    ------
    UnknownNameError
        If there is no such parameter; the message lists similar names.
    ProblemError
        If a target is beyond a bound, no other branch can begin at such a special point, or events are to be stored.
    SolveError
        If ``start`` is a failed solve, or no other branch is found at it.
    StorageError
        If the folder belongs to something else or cannot be written.
    """
    request = Request(
        parameter=parameter,
        to=(to,) if isinstance(to, int | float) else tuple(to),
        lower=lower,
        upper=upper,
        events=events or {},
        max_points=max_points,
        max_seconds=max_seconds,
        verify_every=verify_every,
        follow={"doublings": doublings, "branch_points": branch_points, "mode_changes": mode_changes},
    )
    with shown(progress, value_progress, "continuing", parameter) as show:
        if not output:
            points = list[BranchPoint | SpecialPoint]()
            for point in follow_family(start, request, should_stop=should_stop):
                points.append(point)
                show(len(points), point.value)
            return collected(parameter, points)
        records = _stored_records(start, request, None if output is True else output, should_stop)
        return restore_branch(_shown(records, lambda number, record: show(number, record["value"])))


def _shown(records: Iterator[dict[str, Any]], show: Callable[[int, dict[str, Any]], None]) -> Path:
    """The folder of records, after showing each that no earlier call had stored, with its number."""
    head = next(records)
    for number, record in enumerate(records, start=1):
        if number > head["stored"]:
            show(number, record)
    return Path(head["folder"])


def continuation_records(
    start: Gait | SpecialPoint,
    parameter: str,
    to: float | Sequence[float],
    *,
    lower: float | None = None,
    upper: float | None = None,
    max_points: int = 2000,
    max_seconds: float | None = None,
    verify_every: int = 10,
    doublings: int = 0,
    branch_points: int = 0,
    mode_changes: int = 0,
    output: str | Path | None = None,
    should_stop: Stop = None,
) -> Iterator[dict[str, Any]]:
    """Continue a gait as ``continuation`` does, and yield each point as a JSON object once it is stored on disk.

    Gaits are not kept in memory.

    Parameters
    ----------
    output : run folder of the points, by default that of ``continuation`` with ``output=True``.

    Returns
    -------
    records : first the request (``record: "continuation"``), with the run folder ``folder`` and the number ``stored``
        of records of earlier calls; then all records, with the keys of the command line.

    Raises
    ------
    UnknownNameError, ProblemError, SolveError, StorageError, KeyboardInterrupt
        As ``continuation``.
    """
    request = Request(
        parameter=parameter,
        to=(to,) if isinstance(to, int | float) else tuple(to),
        lower=lower,
        upper=upper,
        max_points=max_points,
        max_seconds=max_seconds,
        verify_every=verify_every,
        follow={"doublings": doublings, "branch_points": branch_points, "mode_changes": mode_changes},
    )
    return _stored_records(start, request, output, should_stop)


def _stored_records(
    start: Gait | SpecialPoint, request: Request, output: str | Path | None, should_stop: Stop
) -> Iterator[dict[str, Any]]:
    if request.events:
        raise ProblemError("events are functions and cannot be stored; leave out events or output")
    request.first_gait(start)  # raises errors before a folder is made
    start = request.begin(start)
    gait = start if isinstance(start, Gait) else start.gait
    assert gait is not None
    kind = start.type if isinstance(start, SpecialPoint) else ""
    folder = None if output is None else Path(output)
    plan = BranchPlan(problem=gait.problem, request=request, start_type=kind, output=folder)
    return plan.records(start, should_stop=should_stop)


def trace(
    special: SpecialPoint | CurveStart,
    key: str,
    to: float | Sequence[float],
    *,
    lower: float | None = None,
    upper: float | None = None,
    max_points: int = 2000,
    max_seconds: float | None = None,
    verify_every: int = 10,
    output: Output = False,
    progress: ValueProgress = True,
    should_stop: Stop = None,
) -> Trace:
    """Follow a special point of a branch in two parameters: that of the branch and a second one.

    A fold, a period doubling, a Neimark-Sacker point or a margin of the mode sequence draws a curve. Codimension-two
    points are located on it. The curve passes changes of the mode sequence where the special point does.

    Parameters
    ----------
    special : a special point of a branch; or an entry of ``next`` at a special point of another trace.
    key : dotted key of the second parameter, any scalar of walker, friction or control.
    to : target value of the second parameter; two values to trace in both directions.
    lower, upper : bounds of the parameter of the branch; by default ten times its value away from that.
    max_points, max_seconds : limits per target; a curve that ends at a limit is ``open``.
    verify_every : verify every N-th point by simulation; 0 for none.
    output : run folder in which every point is stored as soon as it is found; points of earlier calls are read from
        it. True for a folder in ``results`` that is named after gait, special point and targets.
    progress : whether to show it, or a function of the number of points and the second parameter.
    should_stop : polled before every point; True ends the trace there, or raises KeyboardInterrupt with ``output``.

    Returns
    -------
    trace : points and special points, each with its gait and the values of both parameters.

    Raises
    ------
    UnknownNameError
        If there is no such parameter; the message lists similar names.
    ProblemError
        If a special point of this type has no curve, it does not depend on the second parameter, or a target cannot be
        reached.
    SolveError
        If there is no gait at the special point, or Newton's method fails there.
    StorageError
        If the folder belongs to something else or cannot be written.

    References
    ----------
    Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory, ch. 9 and 10.
    """
    request = TraceRequest(
        key=key,
        to=(to,) if isinstance(to, int | float) else tuple(to),
        lower=lower,
        upper=upper,
        max_points=max_points,
        max_seconds=max_seconds,
        verify_every=verify_every,
    )
    with shown(progress, value_progress, "tracing", key) as show:
        if not output:
            found = list[TracePoint | TraceSpecial]()
            for point in follow_curve(special, request, should_stop=should_stop):
                found.append(point)
                show(len(found), point.values[key])
            return collected_trace(special, key, found)
        records = _kept_trace(special, request, None if output is True else output, should_stop)
        return restore_trace(_shown(records, lambda number, record: show(number, record["values"][key])))


def trace_records(
    special: SpecialPoint | CurveStart,
    key: str,
    to: float | Sequence[float],
    *,
    lower: float | None = None,
    upper: float | None = None,
    max_points: int = 2000,
    max_seconds: float | None = None,
    verify_every: int = 10,
    output: str | Path | None = None,
    should_stop: Stop = None,
) -> Iterator[dict[str, Any]]:
    """Follow a special point as ``trace`` does, and yield each point as a JSON object once it is stored on disk.

    Parameters
    ----------
    output : run folder of the points, by default that of ``trace`` with ``output=True``.

    Returns
    -------
    records : first the request (``record: "trace"``), with the run folder ``folder`` and the number ``stored`` of
        records of earlier calls; then all records, with the keys of the command line.

    Raises
    ------
    UnknownNameError, ProblemError, SolveError, StorageError, KeyboardInterrupt
        As ``trace``.
    """
    request = TraceRequest(
        key=key,
        to=(to,) if isinstance(to, int | float) else tuple(to),
        lower=lower,
        upper=upper,
        max_points=max_points,
        max_seconds=max_seconds,
        verify_every=verify_every,
    )
    return _kept_trace(special, request, output, should_stop)


def _kept_trace(
    special: SpecialPoint | CurveStart, request: TraceRequest, output: str | Path | None, should_stop: Stop
) -> Iterator[dict[str, Any]]:
    start = traced_start(special, request)  # raises what is wrong before a folder is written
    folder = None if output is None else Path(output)
    return TracePlan(problem=start.gait.problem, request=request, start=start, output=folder).records(
        start, should_stop=should_stop
    )


def sweep(
    problem: Problem | str | Path,
    over: Over,
    *,
    warm: bool = False,
    from_guess: bool = False,
    method: str = Method.AUTO,
    workers: int | None = None,
    scheduler: str | None = None,
    output: str | Path | None = None,
    progress: CountProgress = True,
    should_stop: Stop = None,
) -> Sweep:
    """Solve and verify a problem on a grid of parameter values, each point as ``solve`` does.

    If the section has one coordinate (or two, with heyoka), whatever ends a cycle, a scan of the return map first rules
    out points without a gait, and finds gaits that ``solve`` misses; ``gaits`` counts the gaits of a point. Points
    without a gait are tried again from the gaits of their neighbours. ``start`` states what led to the gait: ``cold``,
    ``scan``, ``neighbour``.

    Finished points are stored in the run folder; repeat an interrupted call to resume.

    Parameters
    ----------
    over : lower end, upper end and number of values by dotted key: ``{"friction": (0.1, 0.3, 20)}``.
    warm : start each point from the gait of its neighbour instead, and solve it as ``solve`` where that fails. The
        result may then depend on the grid.
    from_guess : solve each point from the problem's guess instead, as ``solve(problem.from_guess())``.
    method : as for ``solve``; results of different methods are stored separately.
    workers : number of processes; by default one per core.
    scheduler : address of an existing Dask scheduler to use instead of local processes, ``tls://host:8786``.
    output : run folder, by default ``results/NAME-HASH``; the sweep is stored in a folder within it, ``folder``.
    progress : whether to show it, or a function of the number of points done and their total.
    should_stop : polled; True ends the call with a KeyboardInterrupt.

    Raises
    ------
    UnknownNameError
        If a key of the grid is not a parameter, or there is no such method.
    ProblemError
        If a range is empty, or a point of the grid is not a valid problem.
    StorageError
        If the folder cannot be written, or the grid does not fit.
    """
    loaded, grid, processes = problem_from(problem), _grid(over), make_workers(workers, scheduler)
    folder = Run.of(loaded, output).folder
    plan = SweepPlan(
        problem=loaded, grid=grid, warm=warm, folder=folder, from_guess=from_guess, method=choice(Method, method)
    )
    with shown(progress, job_progress, "jobs") as show:
        return plan.complete(processes, progress=show, should_stop=should_stop)


def attractors(
    problem: Problem | str | Path,
    over: Over,
    *,
    starts: int = 20,
    transient: int = 200,
    keep: int = 64,
    seed: int = 0,
    engine: str = "auto",
    workers: int | None = None,
    scheduler: str | None = None,
    output: str | Path | None = None,
    progress: CountProgress = True,
    should_stop: Stop = None,
) -> Attractors:
    """Find the attractors of walks at each value of a parameter: cycles, or motions that do not repeat.

    Each attractor has its largest Lyapunov exponent per step, which is positive for chaos. Walks start from the
    attractors of the previous value, from the stable gaits on the branch of the problem's gait, around all of these and
    the guess, and at random.

    Parameters
    ----------
    over : one key with its range, for instance ``{"walker.slope": ("4.2 deg", "5.2 deg", 200)}``.
    starts : number of walks at each value.
    transient : number of cycles to discard first; up to four times as many for walks that have not settled.
    keep : number of cycles to record after them; a motion that repeats within half of them is a cycle.
    seed : random seed.
    engine : ``auto``, ``scipy`` or ``heyoka``.
    workers, scheduler, output, progress, should_stop : as for ``sweep``.

    Raises
    ------
    UnknownNameError, ProblemError, StorageError
        As for ``sweep``; ProblemError also if there is more than one key, or a number is below 1 (``keep``: 2).
    """
    loaded, axis, processes = problem_from(problem), _grid(over).axis, make_workers(workers, scheduler)
    plan = AttractorsPlan(
        problem=loaded, axis=axis, starts=starts, transient=transient, keep=keep, seed=seed,
        engine=choice(Engine, engine), folder=Run.of(loaded, output).folder,
    )  # fmt: skip
    with shown(progress, job_progress, "values") as show:
        return plan.complete(processes, progress=show, should_stop=should_stop)


def robustness(
    gait: Gait | Problem | str | Path,
    *,
    what: str | None = None,
    over: str | None = None,
    random: str | None = None,
    walks: int = 400,
    steps: int = 1000,
    seed: int = 0,
    engine: str = "auto",
    workers: int | None = None,
    scheduler: str | None = None,
    output: str | Path | None = None,
    progress: CountProgress = True,
    should_stop: Stop = None,
) -> Robustness:
    """Measure how robust a stable gait is on an uncertain floor and against pushes.

    A walk *returns* if within 400 steps the state just after the impact is within 1e-6 of the gait's, in natural units.

    - ``range``: the interval of friction, or another parameter, in which the same control has a stable gait without a
      break, from continuation, and what ends it on either side.
    - ``patch``: the last friction from which a walk returns where 1, 2 or 4 tiles have less, or more, friction; the
      highest step of the ground, up and down (1, 2 or 4 equal steps in turn), and the largest slope of 1, 2 or 4 tiles.
    - ``push``: the largest change of each rate just after the impact in both directions, and the nearest state found
      that does not return.
    - ``sensitivity``: the gait sensitivity norm (Hobbelen & Wisse 2007): the root of the sum of the squares of the
      changes that one tile causes in all steps, from friction, height and slope to period, step length, clearance and
      smallest distance to the friction cone. The derivatives are exact for a walker on one foot; for several contacts
      they are extrapolated from differences of walks.
    - ``falls``: mean number of steps to a fall on random tiles, its 99 % interval, and the metastable eigenvalue with
      the mean number of steps that follows from it, also where falls are too rare to be counted.

    Parameters
    ----------
    gait : a stable gait, or its problem, name or path.
    what : one or more of these names, separated by commas; all by default.
    over : dotted key of the parameter of the range; friction by default.
    random : distribution of the tiles on which falls are counted, see ``Floor.random``; by default, friction is uniform
        within 20 % of that of the problem.
    walks : number of walks on random tiles.
    steps : maximum number of steps of such a walk.
    seed : random seed.
    engine : ``auto``, ``scipy`` or ``heyoka``.
    workers, scheduler, output, progress, should_stop : as for ``sweep``. Finished figures are stored; a repeated call
        resumes.

    Raises
    ------
    SolveError
        If there is no gait, or it is unstable.
    ArgumentError, ProblemError, UnknownNameError
        If a word or a distribution is wrong, the walker cannot walk on tiles, or there is no such parameter.
    StorageError
        As for ``sweep``.
    """
    request = RobustnessRequest(
        what=what, over=over, random=random, walks=walks, steps=steps, seed=seed, engine=choice(Engine, engine)
    )
    processes, solved = make_workers(workers, scheduler), gait
    if not isinstance(solved, Gait):
        problem = problem_from(solved)
        check_question(problem, request)
        solved = solve(problem, progress=False, should_stop=should_stop)
    folder = Run.of(solved.problem, output).folder
    plan = RobustnessPlan(problem=solved.problem, gait=solved, folder=folder, **request.arguments)
    with shown(progress, job_progress, "figures") as show:
        return plan.complete(processes, progress=show, should_stop=should_stop)


def atlas(
    problem: Problem | str | Path,
    over: Mapping[str, tuple[float | str, float | str]],
    *,
    slices: int = 9,
    refinements: int = 3,
    max_points: int = 400,
    steps: int | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    output: str | Path | None = None,
    progress: CountProgress = True,
    should_stop: Stop = None,
) -> Atlas:
    """Find where the gaits of a family exist, slip and are stable, over two parameters.

    Branches in the first parameter are computed at some values of the second, and their special points are traced over
    both. Regions have one mode sequence and one number of unstable multipliers; a gait in each is solved and verified.
    Finished branches and curves are stored in the run folder; repeat an interrupted call to resume.

    Parameters
    ----------
    problem : a problem with phases and without free parameters; the family is that of its gait.
    over : lower and upper end by dotted key, of two parameters; the branches are in the first one. An end may be a text
        such as ``"2 deg"``.
    slices : number of branches to begin with.
    refinements : how many times the distance of two branches is halved if the traced curves do not explain how they
        differ.
    max_points : maximum number of points of a branch, on each side of its start.
    steps : largest number of steps of a cycle, by default that of the problem. With twice as many, the families of
        doubled gaits that begin at period doublings are followed too, on sheets of their own.
    workers, scheduler, output, progress, should_stop : as for ``sweep``.

    Returns
    -------
    atlas : regions, curves, codimension-two points, and the branches. Where the family folds over itself, every region
        and curve has the number of its sheet. A region is ``unknown`` where the family could not be followed, and ``no
        gait`` where a fold or another end of the family lies between it and the gaits.

    Raises
    ------
    UnknownNameError, ProblemError, StorageError
        As for ``sweep``; ProblemError also if there are not two keys, or the problem has no phases or free parameters.
    """
    loaded, processes = problem_from(problem), make_workers(workers, scheduler)
    if len(over) != 2:
        raise ArgumentError("over", f"has {counted(len(over), 'key')}, but an atlas needs two parameters")
    try:
        first, second = (axis_of(key, *ends, 2) for key, ends in over.items())
    except ValueError as error:
        raise ArgumentError("over", str(error)) from error
    plan = AtlasPlan(
        problem=loaded, axes=(first, second), slices=slices, refinements=refinements, max_points=max_points,
        steps=steps, folder=Run.of(loaded, output).folder,
    )  # fmt: skip
    with shown(progress, job_progress, "branches and curves") as show:
        return plan.complete(processes, progress=show, should_stop=should_stop)


def basin(
    start: Gait | Problem | str | Path,
    over: Over,
    *,
    steps: int = 100,
    engine: str = "auto",
    floor: Floor | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    output: str | Path | None = None,
    progress: CountProgress = True,
    should_stop: Stop = None,
) -> Basin:
    """Simulate a walk from every state of a grid until it settles on a gait or fails.

    Parameters
    ----------
    start : gait, or problem with a guess; its state gives the coordinates that the grid does not vary.
    over : lower end, upper end and number of values by coordinate: ``{"theta1": ("-12 deg", "-6 deg", 50)}``.
    steps : maximum number of steps; states that have not settled by then are undecided.
    engine : ``auto``, ``scipy`` or ``heyoka``.
    floor : tiles on which every walk begins, see ``Floor``; a walk settles behind them, where the last one repeats.
    workers, scheduler, output, progress, should_stop : as for ``sweep``.

    Raises
    ------
    UnknownNameError, ProblemError, StorageError
        As for ``sweep``.
    """
    origin = start if isinstance(start, Gait) else problem_from(start)
    grid, processes = _grid(over), make_workers(workers, scheduler)
    folder = Run.of(origin.problem if isinstance(origin, Gait) else origin, output).folder
    plan = BasinPlan.around(origin, grid, BasinRequest(steps=steps, engine=choice(Engine, engine)), folder, floor)
    with shown(progress, job_progress, "tiles") as show:
        return plan.complete(processes, progress=show, should_stop=should_stop)


def front(
    problem: Problem | str | Path,
    over: Over,
    *,
    output: str | Path | None = None,
    progress: CountProgress = True,
    should_stop: Stop = None,
) -> Front:
    """Solve a chain of designs over one key of a problem, in both directions, and mark the Pareto front.

    Parameters
    ----------
    problem : a design with an objective.
    over : one key with its range, for instance ``{"constraints.speed.min": (0.3, 0.5, 9)}``.
    output, progress, should_stop : as for ``sweep``.

    Raises
    ------
    ProblemError
        If the problem has no objective, a value is wrong for it, or there is more than one key.
    StorageError
        As for ``sweep``.
    """
    loaded = problem_from(problem)
    plan = FrontPlan(problem=loaded, axis=_grid(over).axis, folder=Run.of(loaded, output).folder)
    with shown(progress, job_progress, "designs") as show:
        return plan.complete(progress=show, should_stop=should_stop)


def multistart(
    problem: Problem | str | Path,
    starts: int,
    *,
    seed: int = 0,
    spread: float = 0.3,
    workers: int | None = None,
    scheduler: str | None = None,
    output: str | Path | None = None,
    progress: CountProgress = True,
    should_stop: Stop = None,
) -> list[Optimum]:
    """Solve from the guess of a problem and ``starts - 1`` sampled ones; list distinct solutions, the best first.

    Parameters
    ----------
    problem : a design; or a problem without unknowns, for its distinct gaits.
    starts : number of starts, the guess of the problem included.
    seed : random seed.
    spread : relative size of the samples: coordinates and free parameters vary by this fraction of their values,
        control points by this fraction of the range of the curve, all within their bounds.
    workers, scheduler, output, progress, should_stop : as for ``sweep``.

    Raises
    ------
    StorageError
        If the folder belongs to something else or cannot be written, or the starts do not fit.
    """
    loaded, processes = problem_from(problem), make_workers(workers, scheduler)
    plan = StartsPlan(problem=loaded, starts=starts, seed=seed, spread=spread, folder=Run.of(loaded, output).folder)
    with shown(progress, job_progress, "starts") as show:
        return plan.complete(processes, progress=show, should_stop=should_stop)


def run_parallel(
    task: Callable[[Any], Any],
    arguments: Iterable[Any],
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    should_stop: Stop = None,
) -> Iterator[tuple[int, Any]]:
    """Call a function for many arguments in several processes.

    Parameters
    ----------
    task : function of one argument, in a module that the processes can import.
    arguments : the arguments of the calls; they and the results are pickled.
    workers, scheduler : as for ``sweep``; with one worker the calls are made in this process.
    should_stop : polled; True cancels the calls that are not finished.

    Yields
    ------
    number, result : index of an argument and result of its call, in the order in which calls finish. If a call fails
        in another process, the result is a ``FailedJob`` with a ``reason``.

    Raises
    ------
    UnknownNameError
        If the scheduler does not answer.
    """
    run = uuid4().hex  # makes the keys of different runs on one scheduler different
    jobs = (Job(key=f"{run}-{number}", argument=argument) for number, argument in enumerate(arguments))
    processes = make_workers(workers, scheduler)
    for key, result in run_jobs(partial(_call, task), jobs, processes, should_stop=should_stop):
        yield int(key.rpartition("-")[2]), result


def _call(task: Callable[[Any], Any], argument: Any, *_: Any) -> Any:
    """The task of a job without a parent."""
    return task(argument)


def _grid(over: Over) -> Grid:
    try:
        return Grid(tuple(axis_of(key, *span) for key, span in over.items()))
    except (TypeError, ValueError) as error:
        raise ProblemError(
            f"over: {error}; write {{KEY: (LO, HI, N)}}, for instance {{'friction': (0.1, 0.3, 20)}}"
        ) from error
