"""``gaitopt continue``: a family of gaits along a parameter, through changes of the mode sequence.

``gaitopt front``: what one aim costs in terms of another, as a chain of verified designs.

``gaitopt sweep``: a grid of problems, solved and verified on all cores or on a cluster.

``gaitopt basin``: which states walk, and on which gait they end.
"""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gaitopt.cli.runs import SPECIAL, gait_of, load, report, save_figures, special_records
from gaitopt.cli.terminal import NOT_A_GAIT, NOT_VERIFIED, Terminal, interruptible
from gaitopt.cli.values import (
    EngineOption,
    GuessOption,
    OutOption,
    OverOption,
    ProblemArgument,
    RunArgument,
    SchedulerOption,
    SetOption,
    WorkersOption,
    counts,
    grid,
    number,
)
from gaitopt.errors import ProblemError, SolveError, StorageError, UnknownNameError

if TYPE_CHECKING:
    from gaitopt.gait.branch import SpecialPoint
    from gaitopt.gait.gait import Gait
    from gaitopt.problem.problem import Problem
    from gaitopt.runs.branch import BranchRun


Record = Mapping[str, Any]

SHOWN = ("record", "branch", "n_steps", "value", "type", "status", "reason", "next", "spectral_radius")
"""Keys of a record that its line and the summary need, so that memory does not grow with the gaits."""

GaitArgument = Annotated[
    str,
    typer.Argument(
        metavar="PROBLEM",
        help="A name, a .yaml file, the run folder of a gait, or RUN@special.K: the other branches through the K-th "
        "special point of a branch, as its table counts them.",
    ),
]
ParamOption = Annotated[str, typer.Option("--param", metavar="KEY", help="What is varied: friction, walker.slope, ...")]
ToOption = Annotated[
    list[str], typer.Option("--to", metavar="VALUE", help="Where to stop; a second --to goes there from the start too.")
]
LowerOption = Annotated[str | None, typer.Option("--lower", metavar="VALUE", help="Bound of the parameter.")]
UpperOption = Annotated[str | None, typer.Option("--upper", metavar="VALUE", help="Bound of the parameter.")]
PointsOption = Annotated[int, typer.Option("--max-points", min=1, help="Maximum number of points per target.")]
SecondsOption = Annotated[float | None, typer.Option("--max-seconds", min=0.0, help="Time limit per target [s].")]
VerifyOption = Annotated[
    int, typer.Option("--verify-every", min=0, help="Every so many points is confirmed by simulation; 0: none.")
]
FollowOption = Annotated[
    list[str] | None,
    typer.Option(
        "--follow",
        metavar="KIND=N",
        help="Follow the other branches of special points too, N times in turn; KIND is doublings, branch_points or "
        "mode_changes. Repeat it.",
    ),
]


def continue_(
    terminal: Terminal,
    problem: GaitArgument,
    param: ParamOption,
    to: ToOption,
    lower: LowerOption = None,
    upper: UpperOption = None,
    max_points: PointsOption = 2000,
    max_seconds: SecondsOption = None,
    verify_every: VerifyOption = 10,
    follow: FollowOption = None,
    changes: SetOption = None,
    output: OutOption = None,
) -> int:
    """Continue a gait in a parameter, through folds and changes of the mode sequence.

    From a special point RUN@special.K its other branches are continued: at a period doubling the cycles of twice as
    many steps, at a branch point the curve that crosses, at a change of modes the sequences that were not followed.
    What is found is kept at once; the same command resumes a walk that was interrupted.
    """
    from gaitopt.branches.request import Request, check_request
    from gaitopt.runs.branch import BranchRun

    request = Request(
        parameter=param,
        to=tuple(number(value, "--to") for value in to),
        lower=None if lower is None else number(lower, "--lower"),
        upper=None if upper is None else number(upper, "--upper"),
        max_points=max_points,
        max_seconds=max_seconds,
        verify_every=verify_every,
        follow=counts(follow),
    )
    if SPECIAL in problem:
        start, gait = _special_point(problem, changes)
    else:
        start, gait = None, gait_of(problem, changes, None, terminal)[0]
    if not gait.converged:
        report(gait, None, terminal)
        return NOT_A_GAIT
    check_request(gait, request)
    run = BranchRun(problem=gait.problem, request=request, start_type=start.type if start else "", output=output)
    with run.run.writing(run.problem):
        refuted = _walk(run, start or gait, terminal)
    return NOT_VERIFIED if refuted else 0


def _special_point(place: str, changes: list[str] | None) -> "tuple[SpecialPoint, Gait]":
    """The special point RUN@special.K and its gait: the K-th of a run's branch, from 0, in the order of the table."""
    from gaitopt.branches.request import family_of
    from gaitopt.store.gaits import special_point

    if changes:
        raise typer.BadParameter(f"--set changes a problem, but {place} is a point of a finished run")
    run, _, index = place.rpartition(SPECIAL)
    problem, parameter, records = special_records(run, f"{place}: ")
    if not index.isdecimal() or int(index) >= len(records):
        known = f"0 to {len(records) - 1}" if records else "none"
        raise StorageError(f"{place}: the special points of this branch are {known}, in the order of the table")
    if problem.free:  # whose values a point of the branch does not hold
        words = "has free parameters: fix them at the values of the design, and continue that"
        raise ProblemError(f"{problem.name} {words}")
    special = special_point(family_of(problem, parameter), parameter, records[int(index)])
    if special.gait is None:
        raise SolveError(f"{place}: there is no gait at this {special.type}")
    return special, special.gait


def _walk(run: "BranchRun", start: "Gait | SpecialPoint", terminal: Terminal) -> bool:
    """Walk along the family, show each record, and say whether the simulator refutes a gait at an end."""
    from gaitopt.show.tables import print_branch, sequence

    refuted, summary = False, list[dict[str, Any]]()
    with interruptible() as interrupted, _live(terminal, run.request.parameter) as show:
        done, to_come = run.walk(start, should_stop=interrupted)
        if done:
            terminal.say(f"resumed from {run.folder} after {len(done)} records")
        for record in chain(done, to_come):
            shown = {key: record[key] for key in SHOWN if key in record}
            if record["record"] == "point":
                shown["sequence"] = sequence(record)
            else:
                verification = record["gait"].get("verification")
                refuted |= record["type"] == "end" and bool(verification) and not verification["passed"]
            summary.append(shown)
            if len(summary) > len(done):
                show(shown)
            if terminal.json:
                terminal.print_json(record)
    if not terminal.json:
        print_branch(terminal.results, summary, run.request.parameter)
        terminal.results.print(f"run: {run.folder}", soft_wrap=True)
    return refuted


@contextmanager
def _live(terminal: Terminal, parameter: str) -> Iterator[Callable[[Record], None]]:
    """A line that follows the walk: a live one on a terminal, one per record elsewhere."""
    from gaitopt.show.tables import event

    console, began, points = terminal.narration, time.monotonic(), 0

    def show(record: Record) -> None:
        nonlocal points
        if record["record"] == "special":
            console.print(f"  {parameter} = {record['value']:.9g}: {event(record)}")
            return
        points += 1
        rate, radius = points / max(time.monotonic() - began, 1e-9), record["spectral_radius"]
        place = f"{parameter} = {record['value']:.6g}  |multiplier| {radius:.4f}"
        words = f"{place}  {record['sequence']}  {rate:.0f} gaits/s"
        if console.is_terminal:
            status.update(words)
        else:
            console.print(f"  {words}")

    with console.status("continuing") as status:
        yield show


def front(
    terminal: Terminal,
    problem: ProblemArgument,
    over: OverOption,
    changes: SetOption = None,
    output: OutOption = None,
) -> int:
    """Design along one number of the problem, in both directions, and mark the Pareto front.

    Every design is kept as soon as it is found; the same command resumes where it stopped.
    """
    from gaitopt.runs.front import check_front, design_front, front_file, front_record
    from gaitopt.show.catalogue import front_figures
    from gaitopt.show.tables import print_front
    from gaitopt.store.run import Run

    axes, loaded = grid(over).axes, load(problem, changes, terminal)
    if len(axes) != 1:
        raise typer.BadParameter("--over: a front runs along one key; give one --over KEY=LO:HI:N")
    run = Run.of(loaded, output)
    run.check(loaded)
    check_front(loaded, axes[0], run.folder)
    with run.writing(loaded):
        with terminal.working("designs") as (progress, interrupted):
            designs = design_front(loaded, axes[0], run.folder, progress=progress, should_stop=interrupted)
        with run.adding(run.place) as figures:
            figures += save_figures(front_figures(designs), run.place)
    path = run.path(front_file(axes[0].key))
    terminal.show(
        {**front_record(designs, axes[0]), "file": str(path), "figures": [str(figure) for figure in figures]},
        print_front,
        "file",
    )
    verifications = [point.gait["verification"] for point in designs if point.converged]
    if not verifications:
        return NOT_A_GAIT
    return 0 if all(entry["passed"] for entry in verifications) else NOT_VERIFIED


WarmOption = Annotated[
    bool,
    typer.Option(
        "--warm", help="Start each point from the gait of its neighbour; the result may then depend on the grid."
    ),
]
WhatOption = Annotated[str, typer.Option("--what", metavar="NAME", help="Scalar of the result that is drawn.")]


def sweep(
    terminal: Terminal,
    problem: ProblemArgument,
    over: OverOption,
    warm: WarmOption = False,
    what: WhatOption = "spectral_radius",
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    changes: SetOption = None,
    from_guess: GuessOption = False,
    output: OutOption = None,
) -> int:
    """Solve and verify a problem over a grid of its parameters; each point as `solve` does with --set.

    What is done is kept and never done again; the same command resumes where it stopped. A point without a gait is a
    result.
    """
    from gaitopt.problem.scalars import SCALARS
    from gaitopt.runs.sweep import TABLE_FILE, SweepPlan, check_sweep, run_sweep, sweep_record
    from gaitopt.show.catalogue import sweep_figures
    from gaitopt.show.tables import print_sweep
    from gaitopt.store.run import Run
    from gaitopt.workers.jobs import make_workers

    if what not in SCALARS:
        raise UnknownNameError(f"--what {what}: no scalar of a sweep; use {', '.join(SCALARS)}")
    points, loaded = grid(over), load(problem, changes, terminal)
    run = Run.of(loaded, output)
    run.check(loaded)
    plan = SweepPlan(problem=loaded, grid=points, warm=warm, folder=run.folder, from_guess=from_guess)
    check_sweep(plan)
    jobs_at = make_workers(workers, scheduler)
    with run.writing(loaded):
        with terminal.working("jobs") as (progress, interrupted):
            swept = run_sweep(plan, jobs_at, progress=progress, should_stop=interrupted)
        record = sweep_record(swept) | {"table": str(plan.run.path(TABLE_FILE)), "run": str(plan.run.place)}
        if len(points.axes) <= 2:
            with run.adding(plan.run.place) as figures:
                figures += save_figures(sweep_figures(swept), plan.run.place, [what])
            record["figures"] = [str(path) for path in figures]
    terminal.show(record, print_sweep, "table")
    return 0


StepsOption = Annotated[int, typer.Option("--steps", min=1, help="Steps after which a state is undecided.")]


def basin(
    terminal: Terminal,
    run: RunArgument,
    over: OverOption,
    steps: StepsOption = 100,
    engine: EngineOption = "auto",
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    changes: SetOption = None,
    output: OutOption = None,
) -> int:
    """Walk from every state of a grid until it settles on a gait or fails.

    The other coordinates are those of RUN's gait. Finished tiles are kept; the same command resumes where it stopped.
    `gaitopt solve RUN@attractor.K` makes a gait of the K-th one, RUN being the folder that is printed.
    """
    from gaitopt.runs.basin import BasinPlan, check_basin, walk_basin
    from gaitopt.show.catalogue import basin_figures
    from gaitopt.show.tables import print_basin
    from gaitopt.simulation.engine import INSTALL, Engine, choose_engine, is_installed
    from gaitopt.store.run import Run
    from gaitopt.workers.jobs import make_workers

    points = grid(over)
    choose_engine(engine)
    tiles_at = make_workers(workers, scheduler)
    start, folder = _start(run, changes, output, terminal)
    plan = BasinPlan.around(start, points, max_steps=steps, engine=engine, folder=folder)
    check_basin(plan)
    if engine == Engine.AUTO and not is_installed():
        terminal.say(f"walking on scipy; heyoka walks several times as fast: {INSTALL}")
    with Run(folder).writing(plan.problem):
        with terminal.working("tiles") as (progress, interrupted):
            result = walk_basin(plan, tiles_at, progress=progress, should_stop=interrupted)
        record = {**result.to_record(), "run": str(plan.run.place)}
        if len(points.axes) <= 2:
            with Run(folder).adding(plan.run.place) as figures:
                figures += save_figures(basin_figures(result), plan.run.place)
            record["figures"] = [str(path) for path in figures]
    terminal.show(record, print_basin, "run")
    return 0


def _start(
    run: str, changes: list[str] | None, output: Path | None, terminal: Terminal
) -> "tuple[Gait | Problem, Path]":
    """The gait that the grid lies around, or the problem with its guess where there is none; and the run folder."""
    from gaitopt.api.stored import save

    gait, folder, fresh = gait_of(run, changes, output, terminal)
    if gait.converged and fresh:
        save(gait, folder)
    elif fresh:
        terminal.say(f"{gait.problem.name} is {gait.status}; the grid lies around its guess")
    return (gait if gait.converged else gait.problem), folder
