"""Computations about the gaits of one problem, with progress and with a run folder that stores the result.

Three arguments mean the same everywhere. ``problem`` may be a name or a path, which ``load_problem`` reads.
``progress`` is True (a bar on a terminal or in a notebook), False, or a function that is called instead. ``output`` is
the run folder in which the result is stored; a call that was interrupted resumes from the contents of its folder.

Some features take functions or arrays and are therefore missing from the command line: ``events`` of ``continuation``,
``run_parallel``, ``return_map``, ``check_walker`` and ``equations_of_motion``.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gaitopt.api.progress import (
    CountProgress,
    TextProgress,
    ValueProgress,
    job_progress,
    shown,
    solver_progress,
    stage_progress,
    word_progress,
)
from gaitopt.api.stored import (
    check_problem_file,
    compared,
    is_element,
    problem_of_element,
    save,
    save_best_point,
    save_replays,
    stored_gait,
    write_problem_file,
)
from gaitopt.callbacks import Stop, TimeLimit
from gaitopt.errors import ArgumentError, GaitoptWarning, ProblemError, SolveError, StorageError, UnknownNameError
from gaitopt.gait.branch import SpecialPoint
from gaitopt.gait.gait import Attractor, Gait, require_converged, require_gait
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
    choice,
)
from gaitopt.runs.grid import check_room
from gaitopt.search import solve as single
from gaitopt.search.find import Gaits, SearchPlan, search, with_open_modes
from gaitopt.solver.program import NonlinearProgram
from gaitopt.store.run import Run
from gaitopt.systems import problem_program, solve_sequence
from gaitopt.verification.verify import verify as verify  # this function is the public verb itself
from gaitopt.verification.walk import Walk
from gaitopt.verification.walk import simulate as simulate_walk
from gaitopt.workers.jobs import ResumableJobs, make_workers

if TYPE_CHECKING:
    from gaitopt.design.derivatives import Derivatives
    from gaitopt.design.neighbourhood import Neighbourhood
    from gaitopt.engines.outcome import Simulator
    from gaitopt.engines.replay import Replay
    from gaitopt.proof.check import Proof
    from gaitopt.runs.multistart import Optimum
    from gaitopt.search.explain import Explanation
    from gaitopt.search.stabilise import Stabilised

Output = str | Path | bool
"""The folder in which a result is stored: True for the default folder in ``results``, False to store nothing."""
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
    wanted, question = choice(Method, method), problem if isinstance(problem, Attractor) else problem_from(problem)
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
    return problem_program(problem_from(problem))


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
    until : the end of the walk instead: ``Until(time=2.0)``, ``Until(events=5)``.
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
    request = SimulateRequest(steps=steps, dense=dense, engine=choice(Engine, engine), longest_step=longest_step)
    if not isinstance(until, Until | None):
        raise ProblemError(f"until is {until!r}, but must be Until(time=SECONDS), Until(steps=N) or Until(events=N)")
    begin = start if isinstance(start, Gait) else problem_from(start, needs_gait=False)
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
    """Find a feedback law that walks a gait stably: virtual constraints, PD control, or a correction once per cycle.

    Virtual constraints: the joints with motors follow Bezier curves over a phase variable. Their end points make them
    invariant under the impact of the gait; the others are those that need the least additional torque, within the
    friction cone and the motors' limits. PD control: the joints track curves over the clock, or over a phase variable,
    with the smallest of the tried gains that suffice. The gait under the law is solved and verified.

    Parameters
    ----------
    start : a gait of a walker with motors, or a problem that is solved for it.
    law : ``virtual_constraints``, ``pd``, or ``step_feedback``, which keeps the law of the gait and corrects its
        parameters once per cycle; virtual constraints by default where the walker has one motor less than shape
        coordinates, otherwise PD control; ``step_feedback`` for more than two steps or another end of the cycle.
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
        motor less than shape coordinates; if a law over a phase or the clock is requested for a gait of more than two
        steps; if no phase is monotone; or if the law has no parameters to correct.
    SolveError
        If the gait is a failed solve, or there is no gait near it under the laws that were tried.
    StorageError
        If the file cannot be written.

    References
    ----------
    Westervelt, Grizzle & Koditschek (2003), IEEE TAC 48(1), section IV: invariance under the impact.
    """
    from gaitopt.search.stabilise import check_phase
    from gaitopt.search.stabilise import stabilise as find_law

    request = StabiliseRequest(
        law=None if law is None else choice(FeedbackLaw, law), phase=phase, degree=degree, radius=radius
    )
    file = None if output is None else check_problem_file(output)
    gait = start
    if not isinstance(gait, Gait):
        problem = problem_from(gait)
        check_phase(problem, phase)
        gait = solve(problem, progress=False, should_stop=should_stop)
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
    unknown = with_open_modes(problem_from(problem))
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
    found : called with the explanation so far, each time that it grows.
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
    loaded, processes = problem_from(problem), make_workers(workers, None)
    with shown(False if callable(progress) else progress, stage_progress, f"explaining {loaded.name}") as show:
        say = progress if callable(progress) else lambda stage: show(stage, 0, 0)
        return explain_problem(
            loaded, request, workers=processes.count, found=found, progress=say,
            parts=parts or (lambda done, total: show("", done, total)), should_stop=should_stop,
        )  # fmt: skip


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
    from gaitopt.engines import replay as engines

    request = ReplayRequest(time_steps=None if time_steps is None else tuple(time_steps))
    simulator = engines.adapter(engine)
    named = engines.named_settings(simulator, settings)
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


def _same_but_for_guess(first: Problem, second: Problem) -> bool:
    fixed = [{k: v for k, v in each.parameters.items() if k not in each.free} for each in (first, second)]
    return (first.name, first.modes, fixed[0]) == (second.name, second.modes, fixed[1])


def problem_from(problem: Problem | str | Path, *, needs_gait: bool = True) -> Problem:
    """The problem that an argument names: a problem, its name, its path, or the path of an element of a run.

    Raises
    ------
    ProblemError
        If the argument is anything else, or the problem has no gait, but ``needs_gait`` is True.
    """
    if isinstance(problem, Problem):
        if needs_gait:
            problem.check_gait()
        return problem
    if not isinstance(problem, str | Path):
        remedy = "; its problem is gait.problem" if isinstance(problem, Gait) else ""
        raise ProblemError(f"expected a problem, its name or its path, not a {type(problem).__name__}{remedy}")
    if is_element(problem):
        return problem_of_element(problem)
    return problem_from(load_problem(problem), needs_gait=needs_gait)


def _folder(problem: Problem, output: Output) -> Path | None:
    """The folder that ``output`` stands for; None if nothing is stored."""
    if output is False:
        return None
    return Run.of(problem, None if output is True else output).folder
