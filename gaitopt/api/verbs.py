"""The computations of gaitopt, one function each, with progress and with a run folder that stores the result.

Three arguments mean the same everywhere. ``problem`` may be a name or a path, which ``load_problem`` reads.
``progress`` is True (a bar on a terminal or in a notebook), False, or a function that is called instead. ``output`` is
the run folder in which the result is stored; a call that was interrupted resumes from the contents of its folder.

Some features take functions or arrays and are therefore missing from the command line: ``events`` of ``continuation``,
``run_parallel``, ``return_map``, ``check_walker`` and ``equations_of_motion``.
"""

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from gaitopt.api.progress import (
    CountProgress,
    TextProgress,
    ValueProgress,
    job_progress,
    shown,
    solver_progress,
    stage_progress,
    value_progress,
    word_progress,
)
from gaitopt.api.stored import compared, is_element, problem_of_element, save, save_best_point, stored_gait
from gaitopt.callbacks import Stop, TimeLimit
from gaitopt.display import counted
from gaitopt.errors import ArgumentError, GaitoptWarning, ProblemError, SolveError, StorageError, UnknownNameError
from gaitopt.gait.branch import Branch, BranchPoint, SpecialPoint, collected
from gaitopt.gait.gait import Attractor, Gait, require_converged, require_gait
from gaitopt.gait.trace import CurveStart, Trace, TracePoint, TraceSpecial, collected_trace
from gaitopt.model.control import Control
from gaitopt.model.open_loop import OpenLoop
from gaitopt.model.walker import Walker
from gaitopt.problem.floor import Floor
from gaitopt.problem.problem import Problem, load_problem
from gaitopt.problem.statement import Until
from gaitopt.requests import (
    INTERVALS,
    IPOPT_ITERATIONS,
    NEWTON_STEPS,
    BasinRequest,
    Engine,
    ExplainRequest,
    FeedbackLaw,
    FindRequest,
    Method,
    ProveRequest,
    ReplayRequest,
    SearchLimits,
    SimulateRequest,
    StabiliseRequest,
    TraceRequest,
    choice,
)
from gaitopt.search import solve as single
from gaitopt.search.find import Gaits, SearchPlan, search, with_open_modes
from gaitopt.solver.program import NonlinearProgram
from gaitopt.store.run import Run
from gaitopt.systems import problem_program, solve_sequence
from gaitopt.verification.verify import verify as verify  # this function is the public verb itself
from gaitopt.verification.walk import Walk
from gaitopt.verification.walk import simulate as simulate_walk
from gaitopt.workers.jobs import Job, ResumableJobs, make_workers, run_jobs

if TYPE_CHECKING:
    from gaitopt.branches.request import Request
    from gaitopt.design.derivatives import Derivatives
    from gaitopt.design.neighbourhood import Neighbourhood
    from gaitopt.engines.outcome import Simulator
    from gaitopt.engines.replay import Replay
    from gaitopt.proof.check import Proof
    from gaitopt.runs.atlas import Atlas
    from gaitopt.runs.attractors import Attractors
    from gaitopt.runs.basin import Basin
    from gaitopt.runs.front import Front
    from gaitopt.runs.grid import Grid
    from gaitopt.runs.multistart import Optimum
    from gaitopt.runs.robustness import Robustness
    from gaitopt.runs.sweep import Sweep
    from gaitopt.search.explain import Explanation
    from gaitopt.search.stabilise import Stabilised

Output = str | Path | bool
"""The folder in which a result is stored: True for the default folder in ``results``, False to store nothing."""
Over = Mapping[str, tuple[float | str, float | str, int]]
"""Lower and upper end and number of values of each dotted key; angles may be texts such as ``"2 deg"``."""

CERTIFICATE_FILE = "proof.json"
"""Name of the file with the certificate of a proof in the run folder of its gait."""
STEP_BYTES_MEMORY, STEP_BYTES_DISK = 40_000, 20_000
"""Estimated size of one simulated step in memory, and on the disk as rows of a table [bytes]."""


def solve(
    problem: Problem | Attractor | str | Path,
    *,
    start: "Gait | Optimum | None" = None,
    method: str = Method.AUTO,
    newton_steps: int = NEWTON_STEPS,
    ipopt_iterations: int = IPOPT_ITERATIONS,
    intervals: int = INTERVALS,
    output: Output = False,
    reuse: bool = False,
    progress: ValueProgress = True,
    should_stop: Stop = None,
) -> Gait:
    """Find the gait of a problem.

    If you changed continuous parameters of a problem with ``replace``, ``solve`` starts from the gait of the original
    file and follows it to the new values. If its family ends on the way, the status is ``infeasible``; the message says
    where, and the causes say which conditions the motion would violate at the new values. The command line, sweeps and
    ``explain`` do the same. ``solve(problem.from_guess())`` starts from the guess instead. ``solve`` itself starts from
    the guess for designs, if the guess, the mode sequence or the structure was changed, and if the problem of the file
    has no gait.

    If the mode sequence is open, ``solve`` calls ``find`` and returns the stable gait nearest to the guess; if none is
    stable, the least unstable one; for a design, the gait with the best objective. If a PD law tracks the gait of
    another problem, that gait is solved first.

    Parameters
    ----------
    problem : a problem, its name or its path. If parameters are free, it is a design, and the result is the best gait
        that meets its constraints. Or an attractor of a basin, whose cycle is solved for a gait.
    start : gait of the same walker, control law and mode sequence, from which a design starts instead of the guess; a
        failed design, which goes on from the point where it ended, also with other constraints or objectives; or
        a solution that ``multistart`` found for this problem, which becomes its gait.
    method : ``newton`` is Newton's method from the guess, or sequential quadratic programming for a design; it also
        follows the gait of a file to changed values. ``ipopt`` solves the NLP (see ``nlp``) from the guess with IPOPT.
        ``auto`` uses IPOPT if Newton's method finds no gait, and for designs. All results are refined to rounding by
        Newton's method; ``gait.solver`` states the method.
    newton_steps : maximum number of Newton steps from the guess; each is at most half as long as the one before.
    ipopt_iterations : maximum number of iterations of IPOPT.
    intervals : number of shooting intervals of a step in the first mesh. Stiff or inaccurate parts of a motion get more
        intervals. These three limits apply to the search for a gait at given parameters; designs and open mode
        sequences have their own limits. ``gait.solver`` states them if they are not the defaults.
    output : run folder; the gait is verified and saved in it. True for ``results/NAME-HASH``.
    reuse : whether to read the gait from the run folder if it is there, like the command line for RUN.
    progress : whether to show it, or a function of the iteration number and the largest constraint violation.
    should_stop : polled at every iteration; True ends the search with the status ``interrupted``.

    Returns
    -------
    gait : check ``gait.status`` or ``gait.converged``; a failed solve does not raise an error.

    Raises
    ------
    ArgumentError
        If a limit is out of its bounds, or given for a design or an open mode sequence.
    UnknownNameError
        If there is no such method.
    SolveError
        If the reference of a PD law is not a gait.
    ProblemError
        If ``reuse`` is given without ``output`` or for an attractor, or if ``start`` is a solution of another problem
        or a failed solve without a point to go on from.
    StorageError
        If the folder contains other files or cannot be written.
    """
    wanted, question = choice(Method, method), problem if isinstance(problem, Attractor) else _loaded(problem)
    loaded = question.problem if isinstance(question, Attractor) else question
    limits = SearchLimits(newton_steps=newton_steps, ipopt_iterations=ipopt_iterations, intervals=intervals)
    if limits.stated:
        _check_limits(question, next(iter(limits.stated)))
    folder = None if isinstance(question, Attractor) else _folder(question, output)
    if reuse:
        if folder is None:
            raise ProblemError("reuse: takes the gait of a problem from its run folder; give output=True or a folder")
        known = stored_gait(loaded, folder)
        stated = {} if known is None else {name: known.solver.get(name) for name in limits.stated}
        if known is not None and wanted in (Method.AUTO, known.solver.get("method")) and stated == limits.stated:
            return known
    guessed, begin = (question, start) if start is None or isinstance(start, Gait) else (start.problem, None)
    if isinstance(start, Gait) and not start.converged:
        if start.best is None or isinstance(question, Attractor):
            raise ProblemError(f"start: {start.problem.name} is {start.status}: {start.message}")
        guessed, begin = loaded.with_guess(start.best), None
    if isinstance(guessed, Problem) and guessed is not loaded and not _same_but_for_guess(guessed, loaded):
        raise ProblemError(f"start: is a solution of another problem, or of other values than those of {loaded.name}")
    with nullcontext() if folder is None else Run(folder).writing(loaded):
        with shown(progress, solver_progress, f"solving {loaded.name}") as show:
            gait = single.solve(
                guessed, start=begin, method=wanted, limits=limits, progress=show, should_stop=should_stop
            )
        gait = gait if begin is start else replace(gait, problem=loaded.at_own_value())
        if output and gait.converged:
            gait = gait.verified(verify(gait).to_record())
            save(gait, folder or _folder(gait.problem, output))
        elif folder is not None and gait.best is not None:
            save_best_point(gait, folder)
    return gait


def _check_limits(question: Problem | Attractor, limit: str) -> None:
    """Refuse a limit of the search from a guessed motion if the problem needs another kind of search."""
    if isinstance(question, Attractor):
        reason = "an attractor, which is a motion already"
    elif question.is_open:
        reason = "a problem with an open mode sequence, for which many gaits are tried"
    elif question.free or question.objective or isinstance(question.control, OpenLoop):
        reason = "a design, which has limits of its own"
    elif question.guess.first is not None:
        reason = "a problem without a guessed state, whose first gait is found by collocation"
    else:
        return
    raise ArgumentError(limit, f"limits the search from a guessed motion, but this is {reason}")


def nlp(problem: Problem | str | Path) -> NonlinearProgram:
    """The nonlinear program of a gait, for any solver of CasADi, with your own objective or constraints.

    Multiple shooting: unknowns are the states at the nodes of a mesh, the durations of the phases, and the freed
    parameters. Constraints are the continuity of the motion, by one Runge-Kutta step of order 8 on every interval; the
    events that end the phases; impacts and periodicity; and the margins of every mode, such as the friction cone. A
    problem without free parameters has as many equations as unknowns, and the objective 0. The program of a design is
    the smoothed problem of its first stage (see the page on designs), with a trust region of the nodes; its optimum is
    not exactly that of the design. Open-loop torques are unknowns of a direct collocation instead, whose
    ``derivatives`` are options for ``casadi.nlpsol``. Its margins hold at the collocation points; ``refined(w)`` is the
    program with more points where a solution violates them in between, or None.

    Parameters
    ----------
    problem : a problem, its name or its path. The start ``x0`` is the motion from its guess; for a design, the gait
        with the guessed parameters if there is one.

    Returns
    -------
    program : expressions ``x, p, f, g``; numbers ``x0, p0, lbx, ubx, lbg, ubg``; ``x_labels`` and ``g_labels``;
        ``casadi()`` and ``arguments()`` for ``casadi.nlpsol``; ``unpack(w)`` and ``pack``; ``gait(w)``.

    Raises
    ------
    ProblemError
        If the mode sequence is open.
    SolveError
        If the reference of a PD law is not a gait.
    """
    return problem_program(_loaded(problem))


def simulate(
    start: Gait | Problem | str | Path,
    state: Mapping[str, float] | None = None,
    steps: int | None = None,
    *,
    until: Until | None = None,
    dense: bool = True,
    engine: str = Engine.AUTO,
    longest_step: float | None = None,
    floor: Floor | None = None,
    compare: bool = False,
    output: Output = False,
    should_stop: Stop = None,
) -> Walk:
    """Simulate a motion from a state, just after an impact or any other.

    Parameters
    ----------
    start : a gait, or a problem, its name or path (then from the state of its guess). The problem needs no gait.
    state : values by name. Section coordinates replace those of the start state just after an impact; the other
        coordinates follow from the section. A whole state (x may be left out) may be any state of the walker: its
        contacts follow from heights and rates.
    steps : number of steps; 1 by default, if the problem does not say until when.
    until : where to end instead: ``Until(time=2.0)``, ``Until(events=5)``.
    dense : False stores only the ends of every arc, for long walks.
    engine : ``auto``, ``scipy`` or ``heyoka``.
    longest_step : longest time from impact to impact [s]; a step that takes longer ends as ``no_touchdown``. 50 times
        the square root of l / g by default.
    floor : friction, height and slope of one tile per step, ``Floor(friction=[0.2, 0.13, 0.13, 0.2])``; see there. A
        step is compared with the gait of the nominal floor.
    compare : compare the walk of a problem with its stored gait, if there is one; always done if ``output`` is given.
    output : run folder of the walk; True for the folder of the problem.
    should_stop : polled at every step.

    Returns
    -------
    walk : ``walk.trajectory.at(t)`` is the state at any time; ``walk.to_record()["impacts"]`` has all impulses.

    Raises
    ------
    SolveError
        If ``start`` is a failed solve, and ``state`` does not say where to start.
    ProblemError
        If a coordinate or rate of the state is missing or not a finite number, the foot is below the ground, ``steps``
        and ``until`` are both given, no step ever ends and ``until`` has neither time nor events, or the walker cannot
        walk on a floor.
    UnknownNameError
        If ``state`` names something that is no coordinate of the walker, or the engine is unknown or not installed.
    StorageError
        If the steps do not fit into memory or on the disk, or the folder cannot be written.
    """
    from gaitopt.runs.grid import check_room

    request = SimulateRequest(steps=steps, dense=dense, engine=choice(Engine, engine), longest_step=longest_step)
    if not isinstance(until, Until | None):
        raise ProblemError(f"until is {until!r}, but must be Until(time=SECONDS), Until(steps=N) or Until(events=N)")
    begin = start if isinstance(start, Gait) else _loaded(start, needs_gait=False)
    problem = begin.problem if isinstance(begin, Gait) else begin
    folder = _folder(problem, output)
    if folder is not None:
        Run(folder).check(problem)
    disk, count = 0 if folder is None else STEP_BYTES_DISK, request.steps or (1 if until is None else until.steps or 1)
    check_room(count, folder or Path(), disk=disk, memory=STEP_BYTES_MEMORY if dense else 0, what="steps")
    walk = simulate_walk(
        begin, state, request.steps, until=until, dense=dense, engine=request.engine,
        longest_step=request.longest_step, floor=floor, should_stop=should_stop,
    )  # fmt: skip
    if compare or folder is not None:
        walk = compared(walk)
    if folder is not None:
        save(walk, folder)
    return walk


def neighbourhood(gait: Gait, *, progress: CountProgress = True) -> "Neighbourhood":
    """Search the feasible neighbourhood of a design for a better gait.

    Parameters
    ----------
    gait : a converged design with an objective.
    progress : whether to show it, or a function of the number of directions done and their total.

    Raises
    ------
    SolveError
        If the gait is not a design.
    """
    from gaitopt.design.neighbourhood import neighbourhood as search_neighbourhood

    require_gait(gait, "neighbourhood")
    with shown(progress, job_progress, "directions") as show:
        return search_neighbourhood(gait, progress=show)


def sensitivity(gait: Gait) -> "Derivatives":
    """Differentiate a gait by its parameters: state, scalars, multipliers and spectral radius.

    Parameters
    ----------
    gait : a converged gait.

    Returns
    -------
    derivatives : exact derivatives in every continuous parameter of walker, friction and control. It prints as a table
        and turns into a data frame; ``of(quantity, parameter)`` is one derivative, NaN where there is none, and
        ``reasons`` says why.

    Raises
    ------
    ProblemError
        If a problem is given.
    SolveError
        If the gait is a failed solve, or is not a function of its parameters, as at a fold.
    """
    from gaitopt.design.derivatives import derivatives

    require_gait(gait, "sensitivity")
    return derivatives(gait)


def stabilise(
    start: Gait | Problem | str | Path,
    *,
    law: str | None = None,
    phase: str | None = None,
    degree: int | None = None,
    radius: float = 1.0,
    output: str | Path | None = None,
    progress: bool | Callable[[str], None] = True,
    should_stop: Stop = None,
) -> "Stabilised":
    """Find a feedback law that walks a gait stably: virtual constraints, PD control, or a correction once per step.

    Virtual constraints: the joints with motors follow Bezier curves over a phase variable. Their end points make them
    invariant under the impact of the gait; the others are those that need the least additional torque, within the
    friction cone and the motors' limits. PD control: the joints track curves over the clock, or over a phase variable,
    with the smallest of the tried gains that suffice. The gait under the law is solved and verified.

    Parameters
    ----------
    start : a gait with one step in a cycle and one contact on the ground, or a problem that is solved for it.
    law : ``virtual_constraints``, ``pd``, or ``step_feedback``, which keeps the law of the gait and corrects its
        parameters once per step; virtual constraints by default where the walker has one motor less than shape
        coordinates, otherwise PD control.
    phase : phase variable of the curves, or ``clock``; by default the first one that is monotone along the gait,
        beginning with those that the walker names; ``clock`` for PD control.
    degree : degree of the curves; by default the lowest one that fits.
    radius : upper bound of the spectral radius.
    output : a file, ``NAME.yaml``, for the problem with the law.
    progress : whether to show it, or a function that is called with a line about each law that is rejected.
    should_stop : polled while gaits are solved.

    Returns
    -------
    stabilised : ``problem`` and ``gait`` under the law, and their distance from the given gait. Its ``objections`` list
        the requirements that the best law found does not meet; they are empty if it meets all of them.

    Raises
    ------
    ProblemError
        If the walker has no motors; if virtual constraints are requested, but the walker does not have exactly one
        motor less than shape coordinates; if the gait has several steps or contacts; or if no phase is monotone.
    SolveError
        If the gait is a failed solve, or there is no gait near it under the laws that were tried.
    StorageError
        If the file cannot be written.

    References
    ----------
    Westervelt, Grizzle & Koditschek (2003), IEEE TAC 48(1), section IV: invariance under the impact.
    """
    from gaitopt.api.stored import check_problem_file, write_problem_file
    from gaitopt.search.stabilise import stabilise as find_law

    request = StabiliseRequest(
        law=None if law is None else choice(FeedbackLaw, law), phase=phase, degree=degree, radius=radius
    )
    file = None if output is None else check_problem_file(output)
    gait = start if isinstance(start, Gait) else solve(start, progress=False, should_stop=should_stop)
    with shown(progress, word_progress, f"stabilising {gait.problem.name}") as show:
        made = find_law(gait, request, say=show, should_stop=should_stop)
    if file is not None:
        write_problem_file(made.problem, file)
    return made


def find(
    problem: Problem | str | Path,
    *,
    steps: int | None = None,
    starts: int = 1000,
    seed: int = 0,
    within: Mapping[str, tuple[float, float]] | None = None,
    method: str = Method.AUTO,
    seconds: float | None = None,
    workers: int | None = 1,
    scheduler: str | None = None,
    output: Output = False,
    found: Callable[[Gaits], None] | None = None,
    progress: CountProgress = True,
    should_stop: Stop = None,
) -> Gaits:
    """Find all gaits at the parameters of a problem, with any mode sequence; the search may miss gaits.

    Parameters
    ----------
    problem : its phases are ignored; its guess is one of the starts. If parameters are free, the best gait of every
        mode sequence is listed.
    steps : maximum number of steps of a cycle; None for that of the problem.
    starts : number of start states of the search by simulation.
    seed : random seed.
    method : method that solves the candidates, as for ``solve``.
    within : fixed ranges of the start states by section coordinate; other ranges adapt to the gaits that are found.
    seconds : time limit of this call; the gaits are then those of the finished parts, and ``searched["complete"]`` is
        False. With ``output`` the same call goes on where it ended.
    workers : number of processes; None for one per core.
    scheduler : address of an existing Dask scheduler to use instead, ``tls://host:8786``.
    output : run folder for finished parts of the search; True for that of the problem with an open mode sequence.
    found : called with the gaits known so far, each time that there are more.
    progress : whether to show it, or a function of the number of finished parts of the search and their total.
    should_stop : polled; True ends the search with a KeyboardInterrupt.

    Returns
    -------
    gaits : each solved to 1e-10 and verified; stable ones first, then by spectral radius.

    Raises
    ------
    UnknownNameError
        If ``within`` names something that is not a section coordinate, or there is no such method.
    StorageError
        If the folder belongs to something else or cannot be written.

    Warns
    -----
    GaitoptWarning
        If gaits are near the wall of the last box of start states, or outside it.
    """
    request = FindRequest(
        steps=steps, starts=starts, seed=seed, within=within or {}, method=choice(Method, method), seconds=seconds
    )
    unknown = with_open_modes(_loaded(problem))
    unknown = unknown if request.steps is None else unknown.replace({"gait.steps": request.steps})
    plan = SearchPlan(problem=unknown, starts=starts, seed=seed, within=request.within, method=request.method)
    processes, folder = make_workers(workers, scheduler), _folder(plan.problem, output)
    limit = TimeLimit(seconds=request.seconds)
    with shown(progress, job_progress, "parts of the search") as show:
        if folder is None:
            jobs = ResumableJobs(workers=processes, progress=show, should_stop=should_stop, limit=limit)
            gaits = search(plan, jobs, found=found)
        else:
            from gaitopt.runs.jobs import FindPlan

            resumable = FindPlan(**vars(plan), folder=folder, found=found)
            gaits = resumable.complete(processes, progress=show, should_stop=should_stop, limit=limit)
    for sentence in gaits.searched["warnings"]:
        warnings.warn(sentence, GaitoptWarning, stacklevel=2)
    return gaits


def explain(
    problem: Problem | str | Path,
    *,
    starts: int = 1000,
    seed: int = 0,
    seconds: float | None = None,
    workers: int | None = 1,
    found: "Callable[[Explanation], None] | None" = None,
    progress: TextProgress = True,
    parts: Callable[[int, int], None] | None = None,
    should_stop: Stop = None,
) -> "Explanation":
    """Explain why a problem has no gait: violated conditions, other gaits, and the nearest values with a gait.

    The violated conditions and the end of the family of the file's gait take a second or two. The search for other
    gaits and for the nearest values takes a hundred times as long.

    Parameters
    ----------
    starts, seed, workers : as for ``find``, for the search for gaits with other mode sequences.
    seconds : time limit; the explanation then lacks what the search would have found later, and ``complete`` is False.
    found : called with the explanation so far, each time that a part is added.
    progress : whether to show it, or a function that is called with a description of each stage.
    parts : called with the number of finished parts of a stage and their total.
    should_stop : polled at every iteration.

    Raises
    ------
    KeyboardInterrupt
        If ``should_stop`` returned True.
    """
    from gaitopt.search.explain import explain as explain_problem

    request = ExplainRequest(starts=starts, seed=seed, seconds=seconds)
    loaded, processes = _loaded(problem), make_workers(workers, None)
    with shown(False if callable(progress) else progress, stage_progress, f"explaining {loaded.name}") as show:
        say = progress if callable(progress) else lambda stage: show(stage, 0, 0)
        return explain_problem(
            loaded, request, workers=processes.count, found=found, progress=say,
            parts=parts or (lambda done, total: show("", done, total)), should_stop=should_stop,
        )  # fmt: skip


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
    from gaitopt.branches.continuation import follow_family
    from gaitopt.branches.request import Request

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
        from gaitopt.runs.branch import restore_branch

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

    Gaits are not held in memory.

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
    from gaitopt.branches.request import Request

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
    start: Gait | SpecialPoint, request: "Request", output: str | Path | None, should_stop: Stop
) -> Iterator[dict[str, Any]]:
    from gaitopt.runs.branch import BranchPlan

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
    from gaitopt.branches.trace import follow_curve

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
        from gaitopt.runs.trace import restore_trace

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
    from gaitopt.branches.trace import traced_start
    from gaitopt.runs.trace import TracePlan

    start = traced_start(special, request)  # raises what is wrong before a folder is written
    folder = None if output is None else Path(output)
    return TracePlan(problem=start.gait.problem, request=request, start=start, output=folder).records(
        start, should_stop=should_stop
    )


def prove(
    start: Gait | SpecialPoint,
    intervals: Mapping[str, str] | None = None,
    *,
    parameter: str | None = None,
    width: float | None = None,
    output: Output = False,
    progress: TextProgress = True,
) -> "Proof":
    """Prove that a gait exists, is locally unique, has its mode sequence, and is stable or unstable.

    For a special point of a branch, prove that the family exists around it, and that the function that defines the
    special point changes its sign.

    Parameters
    ----------
    start : a converged gait, from which the proof starts but on which it does not rely; or a special point with a gait.
    intervals : intervals of parameters by dotted key, such as ``0.18..0.25``; the theorem holds for all values in them.
    parameter : the parameter of the branch, for a special point.
    width : width of the bracket around a special point; None for the narrowest provable one.
    output : file for the certificate; True for ``proof.json`` in the run folder of the gait.
    progress : whether to show it, or a function that is called with a description of each stage.

    Raises
    ------
    UnknownNameError
        If a key is not a parameter of the gait, or no special point of this type can be proved.
    ValueError
        If an interval is malformed, ``parameter`` is missing, or ``width`` is out of its bounds.
    SolveError
        If ``start`` is a failed solve, or there is no gait at the special point.
    StorageError
        If the certificate cannot be written.
    """
    from gaitopt.proof.check import BRACKETED  # these modules need the extra "proof"
    from gaitopt.proof.prove import prove as prove_gait
    from gaitopt.proof.prove import prove_special
    from gaitopt.store.files import check_file, make_folder, write_whole
    from gaitopt.store.formats import json_text

    require_gait(start, "prove")
    width = ProveRequest(width=width).width
    gait = start.gait if isinstance(start, SpecialPoint) else start
    file = None if isinstance(output, bool) else Path(output)
    if file is not None:
        check_file(file)
    if isinstance(start, SpecialPoint):
        if parameter is None:
            raise ProblemError("parameter: missing; name the parameter of the branch of this special point")
        if start.type not in BRACKETED or gait is None:
            raise UnknownNameError(f"the special point is of type {start.type}; {', '.join(BRACKETED)} can be proved")
        problem = gait.problem.with_gait(gait.to_record()).replace({parameter: start.value})
        gait = single.solve(problem)  # refined, and with the shooting nodes that a special point lacks
    if gait is None:
        raise SolveError(f"{start!r} has no gait")
    require_converged(gait)
    if output is True:
        file = Run.of(gait.problem).path(CERTIFICATE_FILE)
        check_file(file)
    with shown(progress, word_progress, f"proving {gait.problem.name}") as say:
        if isinstance(start, SpecialPoint) and parameter is not None:
            proof = prove_special(gait, parameter, start.type, width, solve=solve_sequence, progress=say)
        else:
            proof = prove_gait(gait, intervals, solve=solve_sequence, progress=say)
    if file is not None:
        make_folder(file.parent)
        write_whole(file, json_text(proof.certificate) + "\n")
    return proof


def check_proof(
    path: str | Path, *, walkers: Sequence[type[Walker]] = (), controls: Sequence[type[Control]] = ()
) -> "Proof":
    """Verify the certificate of a proof again, without any search.

    Parameters
    ----------
    walkers, controls : classes of the walker and control law of the certificate, if they are not registered.

    Raises
    ------
    StorageError
        If the file cannot be read, or is not a certificate.
    """
    from gaitopt.proof.certificate import LARGEST_FILE, parse_certificate
    from gaitopt.proof.check import check
    from gaitopt.store.formats import reason

    file = Path(path)
    try:
        if file.exists() and not file.is_file():
            raise StorageError(f"{file} is not a proof certificate: it is not a regular file")
        with file.open("rb") as stream:
            content = stream.read(LARGEST_FILE + 1)
    except FileNotFoundError as error:
        raise StorageError(f"{file} is missing") from error
    except (OSError, ValueError) as error:
        raise StorageError(f"cannot read {file}: {reason(error)}") from error
    try:
        return check(parse_certificate(content), walkers=walkers, controls=controls)
    except StorageError as error:
        raise StorageError(f"{file} is not a proof certificate: {error}") from error


def replay(
    start: Gait | Problem | str | Path,
    engine: "str | type[Simulator]",
    *,
    settings: str | Mapping[str, Mapping[str, Any]] | None = None,
    time_steps: Sequence[float] | None = None,
    output: Output = False,
    progress: CountProgress = True,
    should_stop: Stop = None,
) -> "list[Replay]":
    """Replay a gait in another physics engine, and measure its errors.

    The engine starts from the state of the gait just after an impact and simulates one cycle with several time steps.
    It runs in a separate process, so a crash of the engine is a result.

    Parameters
    ----------
    start : a gait, or a problem that is solved for its gait.
    engine : ``mujoco``, ``drake`` or ``pybullet``, from the extra ``engines``; ``siconos``, from Debian; or your own
        adapter, a class in a module that another process can import.
    settings : name of a setting of the adapter, ``default`` or ``best``; or your own settings by name, with the same
        keys. Default: all settings of the adapter.
    time_steps : time steps of the engine [s]. Default: 4, 2, 1, 0.5 and 0.25 ms.
    output : run folder for the results, ``replay-ENGINE.json``; ``report`` reads them.
    progress : whether to show it, or a function of the number of finished runs and their total.
    should_stop : polled; True ends the call with a KeyboardInterrupt.

    Returns
    -------
    replays : one per setting, with an outcome per time step.

    Raises
    ------
    UnknownNameError
        If there is no such engine or setting, or the engine is not installed.
    ProblemError
        If a time step is not positive, or the engine has no law for the walker: it has static friction above kinetic
        friction, flight, joint stops, a slipping impact without friction, ...
    SolveError
        If the solve fails.
    StorageError
        If the folder cannot be written.
    """
    from gaitopt.api.stored import save_replays
    from gaitopt.engines import replay as engines

    request = ReplayRequest(time_steps=None if time_steps is None else tuple(time_steps))
    simulator = engines.adapter(engine)
    known = simulator.settings
    if isinstance(settings, str) and settings not in known:
        message = f"{settings!r}: {simulator.name} has no setting of this name; use {', '.join(known)}"
        raise UnknownNameError(message).concerning("setting")
    named = known if settings is None else {settings: known[settings]} if isinstance(settings, str) else settings
    steps = sorted({*(request.time_steps or engines.TIME_STEPS)}, reverse=True)
    gait = start if isinstance(start, Gait) else solve(start, progress=False, should_stop=should_stop)
    require_converged(gait)
    folder = _folder(gait.problem, output)
    if folder is not None:
        Run(folder).check(gait.problem, write=True)
    done, total = 0, len(named) * len(steps)
    with shown(progress, job_progress, f"runs of {simulator.name}") as show:

        def finished(outcome: Any) -> None:
            nonlocal done
            done += 1
            show(done, total)

        replays = engines.replay(gait, simulator, named, steps, finished, should_stop)
    if folder is not None:
        save_replays(replays, gait, folder)
    return replays


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
) -> "Sweep":
    """Solve and verify a problem on a grid of parameter values, each point as ``solve`` does.

    If the section has one coordinate (or two, with heyoka), a scan of the return map first rules out points without a
    gait, and finds gaits that ``solve`` misses; ``gaits`` counts the gaits of a point. Points without a gait are tried
    again from the gaits of their neighbours. ``start`` states what led to the gait: ``cold``, ``scan``, ``neighbour``.

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
    from gaitopt.runs.sweep import SweepPlan

    loaded, grid, processes = _loaded(problem), _grid(over), make_workers(workers, scheduler)
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
) -> "Attractors":
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
    from gaitopt.runs.attractors import AttractorsPlan

    loaded, axis, processes = _loaded(problem), _grid(over).axis, make_workers(workers, scheduler)
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
) -> "Robustness":
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
      least distance to the friction cone. The derivatives are exact for a walker on one foot; for several contacts they
      are extrapolated from differences of walks.
    - ``falls``: mean number of steps to a fall on random tiles, its 99 % interval, and the metastable eigenvalue.

    Parameters
    ----------
    gait : a stable gait, or its problem, name or path.
    what : one or more of these words, separated by commas; all by default.
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
    from gaitopt.runs.robustness import RobustnessPlan

    processes = make_workers(workers, scheduler)
    solved = gait if isinstance(gait, Gait) else solve(_loaded(gait), progress=False, should_stop=should_stop)
    plan = RobustnessPlan(
        problem=solved.problem, gait=solved, what=what, over=over, random=random, walks=walks, steps=steps, seed=seed,
        engine=choice(Engine, engine), folder=Run.of(solved.problem, output).folder,
    )  # fmt: skip
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
) -> "Atlas":
    """Find where the gaits of a family exist, slip and are stable, over two parameters.

    Branches in the first parameter are computed at some values of the second, and their special points are traced over
    both. Regions have one mode sequence and one number of unstable multipliers; a gait in each is solved and verified.
    Finished branches and curves are stored in the run folder; repeat an interrupted call to resume.

    Parameters
    ----------
    problem : with phases and without free parameters; the family is that of its gait.
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
        and curve has the number of its sheet. A place is ``unknown`` where the family could not be followed, and ``no
        gait`` where a fold or another end of the family lies between it and the gaits.

    Raises
    ------
    UnknownNameError, ProblemError, StorageError
        As for ``sweep``; ProblemError also if there are not two keys, or the problem has no phases or free parameters.
    """
    from gaitopt.runs.atlas import AtlasPlan
    from gaitopt.runs.grid import axis_of

    loaded, processes = _loaded(problem), make_workers(workers, scheduler)
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
) -> "Basin":
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
    from gaitopt.runs.basin import BasinPlan

    origin = start if isinstance(start, Gait) else _loaded(start)
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
) -> "Front":
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
    from gaitopt.runs.front import FrontPlan

    loaded = _loaded(problem)
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
) -> "list[Optimum]":
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
    from gaitopt.runs.multistart import StartsPlan

    loaded, processes = _loaded(problem), make_workers(workers, scheduler)
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


def _same_but_for_guess(first: Problem, second: Problem) -> bool:
    fixed = [{k: v for k, v in each.parameters.items() if k not in each.free} for each in (first, second)]
    return (first.name, first.modes, fixed[0]) == (second.name, second.modes, fixed[1])


def _loaded(problem: Problem | str | Path, *, needs_gait: bool = True) -> Problem:
    if isinstance(problem, Problem):
        if needs_gait:
            problem.check_gait()
        return problem
    if not isinstance(problem, str | Path):
        remedy = "; its problem is gait.problem" if isinstance(problem, Gait) else ""
        raise ProblemError(f"expected a problem, its name or its path, not a {type(problem).__name__}{remedy}")
    if is_element(problem):
        return problem_of_element(problem)
    return _loaded(load_problem(problem), needs_gait=needs_gait)


def _folder(problem: Problem, output: Output) -> Path | None:
    """The folder that ``output`` stands for; None if nothing is stored."""
    if output is False:
        return None
    return Run.of(problem, None if output is True else output).folder


def _grid(over: Over) -> "Grid":
    from gaitopt.runs.grid import Grid, axis_of

    try:
        return Grid(tuple(axis_of(key, *span) for key, span in over.items()))
    except (TypeError, ValueError) as error:
        raise ProblemError(
            f"over: {error}; write {{KEY: (LO, HI, N)}}, for instance {{'friction': (0.1, 0.3, 20)}}"
        ) from error
