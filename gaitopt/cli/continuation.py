"""``gaitopt continue``: a family of gaits along a parameter, through changes of the mode sequence."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import chain
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gaitopt.cli.branches import SPECIAL, special_records
from gaitopt.cli.endings import NOT_A_GAIT, NOT_VERIFIED
from gaitopt.cli.options import OutOption, SetOption
from gaitopt.cli.runs import gait_of, report
from gaitopt.cli.signals import interruptible
from gaitopt.cli.terminal import Terminal
from gaitopt.cli.values import counts, number
from gaitopt.errors import ProblemError, SolveError, StorageError

if TYPE_CHECKING:
    from gaitopt.gait import Gait, SpecialPoint
    from gaitopt.runs.branch_run import BranchRun

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
    from gaitopt.families import Request, check_request
    from gaitopt.runs.branch_run import BranchRun
    from gaitopt.store import writing

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
    with writing(run.folder, run.problem):
        refuted = _walk(run, start or gait, terminal)
    return NOT_VERIFIED if refuted else 0


def _special_point(place: str, changes: list[str] | None) -> "tuple[SpecialPoint, Gait]":
    """The special point RUN@special.K and its gait: the K-th of a run's branch, from 0, in the order of the table."""
    from gaitopt.families.records import family_of, recorded_special

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
    special = recorded_special(family_of(problem, parameter), parameter, records[int(index)])
    if special.gait is None:
        raise SolveError(f"{place}: there is no gait at this {special.type}")
    return special, special.gait


def _walk(run: "BranchRun", start: "Gait | SpecialPoint", terminal: Terminal) -> bool:
    """Walk along the family, show each record, and say whether the simulator refutes a gait at an end."""
    from gaitopt.library.print_results import print_branch, sequence

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
    from gaitopt.library.print_results import event

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
