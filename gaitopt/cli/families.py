"""Commands about many gaits or many walks: ``continue``, ``front``, ``sweep``, ``basin``.

Results are kept as soon as they are computed; the same command resumes where it stopped.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gaitopt.cli.options import (
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
from gaitopt.cli.runs import SPECIAL, gait_of, load, report, special_records
from gaitopt.cli.signals import interruptible
from gaitopt.cli.terminal import NOT_A_GAIT, NOT_VERIFIED, Terminal
from gaitopt.errors import ProblemError, SolveError, StorageError, UnknownNameError

if TYPE_CHECKING:
    from gaitopt.gait.branch import SpecialPoint
    from gaitopt.gait.gait import Gait
    from gaitopt.problem.problem import Problem
    from gaitopt.runs.basin import Basin
    from gaitopt.runs.branch import BranchPlan
    from gaitopt.runs.sweep import Sweep


Record = Mapping[str, Any]

SHOWN = ("record", "branch", "n_steps", "value", "type", "status", "reason", "next", "spectral_radius")
"""Keys of a record that its line and the summary need; the gaits themselves are not held in memory."""

GaitArgument = Annotated[
    str,
    typer.Argument(
        metavar="PROBLEM",
        help="A name, a .yaml file, the run folder of a gait, or RUN@special.K: the other branches through the K-th "
        "special point in the table of a branch.",
    ),
]
ParamOption = Annotated[str, typer.Option("--param", metavar="KEY", help="Parameter: friction, walker.slope, ...")]
ToOption = Annotated[
    list[str],
    typer.Option(
        "--to", metavar="VALUE", help="Value at which to stop; with a second --to the branch is followed both ways."
    ),
]
LowerOption = Annotated[str | None, typer.Option("--lower", metavar="VALUE", help="Lower bound of the parameter.")]
UpperOption = Annotated[str | None, typer.Option("--upper", metavar="VALUE", help="Upper bound of the parameter.")]
PointsOption = Annotated[int, typer.Option("--max-points", min=1, help="Maximum number of points per target.")]
SecondsOption = Annotated[float | None, typer.Option("--max-seconds", min=0.0, help="Time limit per target [s].")]
VerifyOption = Annotated[
    int, typer.Option("--verify-every", min=0, help="Verify every N-th point by simulation; 0: none.")
]
FollowOption = Annotated[
    list[str] | None,
    typer.Option(
        "--follow",
        metavar="KIND=N",
        help="Also follow the other branches of special points, N times in turn; KIND is doublings, branch_points or "
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

    RUN@special.K continues the other branches of a special point: at a period doubling the cycles of twice as many
    steps, at a branch point the curve that crosses, at a change of modes the sequences that were not followed.
    Every point is kept at once; the same command resumes a branch that was interrupted.
    """
    from gaitopt.branches.request import Request
    from gaitopt.runs.branch import BranchPlan

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
    request.first_gait(start or gait)
    plan = BranchPlan(problem=gait.problem, request=request, start_type=start.type if start else "", output=output)
    with plan.run.writing(plan.problem):
        refuted = _walk(plan, start or gait, terminal)
    return NOT_VERIFIED if refuted else 0


def _special_point(place: str, changes: list[str] | None) -> "tuple[SpecialPoint, Gait]":
    """The special point RUN@special.K and its gait; K counts from 0 in the order of the table."""
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


def _walk(plan: "BranchPlan", start: "Gait | SpecialPoint", terminal: Terminal) -> bool:
    """Walk along the family and show each record; True if the simulator refutes a gait at an end."""
    from gaitopt.gait.records import special_gait
    from gaitopt.show.tables import print_branch, sequence

    refuted, summary = False, list[dict[str, Any]]()
    with interruptible() as interrupted, _live(terminal, plan.request.parameter) as show:
        done, to_come = plan.walk(start, should_stop=interrupted)
        if done:
            terminal.say(f"resumed from {plan.folder} after {len(done)} records")
        for record in chain(done, to_come):
            shown = {key: value for key, value in record.items() if key in SHOWN}
            if record["record"] == "point":
                shown["sequence"] = sequence(record)
            else:
                gait = special_gait(record)
                verification = None if gait is None else gait["verification"]
                refuted |= record["type"] == "end" and verification is not None and not verification["passed"]
            summary.append(shown)
            if len(summary) > len(done):
                show(shown)
            if terminal.json:
                terminal.print_json(record)
    if not terminal.json:
        print_branch(terminal.results, summary, plan.request.parameter)
        terminal.results.print(f"run: {plan.folder}", soft_wrap=True)
    return refuted


@contextmanager
def _live(terminal: Terminal, parameter: str) -> Iterator[Callable[[Record], None]]:
    """Yield a function that shows a record: on a terminal a live line, elsewhere one line per record."""
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

    Every design is kept at once; the same command resumes where it stopped.
    """
    from gaitopt.api import verbs
    from gaitopt.api.pictures import save_figures
    from gaitopt.gait.records import is_gait
    from gaitopt.show.tables import print_front
    from gaitopt.store.run import Run

    ranges, loaded = grid(over), load(problem, changes, terminal)
    if len(ranges) != 1:
        raise typer.BadParameter("--over: a front runs along one key; give one --over KEY=LO:HI:N")
    run = Run.of(loaded, output)
    with terminal.working("designs") as (progress, interrupted):
        designs = verbs.front(loaded, ranges, output=run.folder, progress=progress, should_stop=interrupted)
    with run.adding(run.place) as figures:
        figures += save_figures(designs, run.place)
    record = {**designs.to_record(), "file": str(designs.file), "figures": [str(figure) for figure in figures]}
    terminal.show(record, print_front, "file")
    gaits = [point.gait for point in designs if is_gait(point.gait)]
    if not gaits:
        return NOT_A_GAIT
    return 0 if all(gait["verification"] and gait["verification"]["passed"] for gait in gaits) else NOT_VERIFIED


WarmOption = Annotated[
    bool,
    typer.Option(
        "--warm", help="Start each point from the gait of its neighbour; the result may then depend on the grid."
    ),
]
WhatOption = Annotated[str, typer.Option("--what", metavar="NAME", help="Scalar to draw.")]


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

    Every result is kept at once; the same command resumes where it stopped. A point without a gait is a result.
    """
    from gaitopt.api import verbs
    from gaitopt.problem.scalars import SCALARS
    from gaitopt.runs.sweep import TABLE_FILE
    from gaitopt.show.tables import print_sweep
    from gaitopt.store.run import Run

    if what not in SCALARS:
        raise UnknownNameError(f"--what {what}: no scalar of a sweep; use {', '.join(SCALARS)}")
    ranges, loaded = grid(over), load(problem, changes, terminal)
    folder = Run.of(loaded, output).folder
    with terminal.working("jobs") as (progress, interrupted):
        swept = verbs.sweep(
            loaded, ranges, warm=warm, from_guess=from_guess, workers=workers, scheduler=scheduler, output=folder,
            progress=progress, should_stop=interrupted,
        )  # fmt: skip
    place = {"table": f"{swept.folder}/{TABLE_FILE}", "run": str(swept.folder)}
    terminal.show({**swept.to_record(), **place, **_drawn(swept, folder, [what])}, print_sweep, "table")
    return 0


StepsOption = Annotated[int, typer.Option("--steps", min=1, help="Maximum number of steps of each walk.")]


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
    `gaitopt solve RUN@attractor.K` solves the gait of the K-th attractor, where RUN is the folder that is printed.
    """
    from gaitopt.api import verbs
    from gaitopt.show.tables import print_basin
    from gaitopt.simulation.engine import INSTALL, Engine, choose_engine, is_installed

    ranges = grid(over)
    choose_engine(engine)
    start, folder = _start(run, changes, output, terminal)
    if engine == Engine.AUTO and not is_installed():
        terminal.say(f"walking on scipy; heyoka walks several times as fast: {INSTALL}")
    with terminal.working("tiles") as (progress, interrupted):
        result = verbs.basin(
            start, ranges, steps=steps, engine=engine, workers=workers, scheduler=scheduler, output=folder,
            progress=progress, should_stop=interrupted,
        )  # fmt: skip
    record = {**result.to_record(), "run": str(result.folder), **_drawn(result, folder, ())}
    terminal.show(record, print_basin, "run")
    return 0


def _drawn(result: "Sweep | Basin", run: Path, what: Sequence[str]) -> dict[str, list[str]]:
    """Draw a sweep or a basin over one or two keys into its folder; the entry ``figures`` of its record."""
    from gaitopt.api.pictures import DRAWN_AXES, save_figures
    from gaitopt.store.run import Run

    if result.folder is None or len(result.grid.axes) > DRAWN_AXES:
        return {}
    with Run(run).adding(result.folder) as figures:
        figures += save_figures(result, result.folder, what)
    return {"figures": [str(path) for path in figures]}


def _start(
    run: str, changes: list[str] | None, output: Path | None, terminal: Terminal
) -> "tuple[Gait | Problem, Path]":
    """The gait around which the grid lies, or the problem if it has no gait; and the run folder."""
    from gaitopt.api.stored import save

    gait, folder, fresh = gait_of(run, changes, output, terminal)
    if gait.converged and fresh:
        save(gait, folder)
    elif fresh:
        terminal.say(f"{gait.problem.name} is {gait.status}; the grid lies around its guess")
    return (gait if gait.converged else gait.problem), folder
