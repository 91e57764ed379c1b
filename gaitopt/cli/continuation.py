"""``gaitopt continue``: a family of gaits along a parameter, through changes of the mode sequence."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gaitopt.cli.options import DebugOption, OutOption, QuietOption, SetOption

if TYPE_CHECKING:
    from rich.console import Console

    from gaitopt.gait import Gait, SpecialPoint
    from gaitopt.runs.branch_run import BranchRun

NOT_A_GAIT = 4
DISAGREES = 5

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
PointsOption = Annotated[int, typer.Option("--max-points", min=1, help="Most points towards each target.")]
SecondsOption = Annotated[float | None, typer.Option("--max-seconds", min=0.0, help="Wall time for this time [s].")]
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
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object per line, as soon as it is found.")]


def continue_(
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
    json: JsonOption = False,
    quiet: QuietOption = False,
    debug: DebugOption = False,
) -> int:
    """Continue a gait in a parameter, through folds and changes of the mode sequence.

    From a special point RUN@special.K its other branches are continued: at a period doubling the cycles of twice as
    many steps, at a branch point the curve that crosses, at a change of modes the sequences that were not followed.
    What is found is kept at once; the same command takes up a walk that was cut short.
    """
    from gaitopt.cli.console import narration, print_json
    from gaitopt.cli.solve import report
    from gaitopt.families import Request, check_request
    from gaitopt.gait import SpecialPoint
    from gaitopt.runs.branch_run import BranchRun
    from gaitopt.store import writing

    followed = _follow(follow)
    request = Request(
        parameter=param,
        to=tuple(_number(value, "--to") for value in to),
        lower=None if lower is None else _number(lower, "--lower"),
        upper=None if upper is None else _number(upper, "--upper"),
        max_points=max_points,
        max_seconds=max_seconds,
        verify_every=verify_every,
        doublings=followed.get("doublings", 0),
        branch_points=followed.get("branch_points", 0),
        mode_changes=followed.get("mode_changes", 0),
    )
    console = narration(quiet=quiet)
    start = _start(problem, changes, console)
    gait = start.gait if isinstance(start, SpecialPoint) else start
    if gait is None or not gait.converged:
        assert gait is not None, "a special point without a gait is refused"
        report(gait, None, json=json)
        return NOT_A_GAIT
    check_request(gait, request)
    kind = start.type if isinstance(start, SpecialPoint) else ""
    run = BranchRun(problem=gait.problem, request=request, start_type=kind, output=output)
    with writing(run.folder, run.problem):
        records = _walk(run, start, console, print_json if json else None)
    if not json:
        _print_summary(records, run.folder)
    return DISAGREES if any(record["refuted"] for record in records) else 0


def _start(problem: str, changes: list[str] | None, console: "Console") -> "Gait | SpecialPoint":
    """The gait of a problem or run, or a special point of a branch.

    Raises
    ------
    SolveError
        If there is no gait at the special point.
    """
    from gaitopt.cli.branches import SPECIAL, stored_special
    from gaitopt.cli.runs import gait_of
    from gaitopt.errors import SolveError

    if SPECIAL not in problem:
        return gait_of(problem, changes, None, console)[0]
    if changes:
        raise typer.BadParameter(f"--set changes a problem, but {problem} is a point of a finished run")
    special = stored_special(problem)
    if special.gait is None:
        raise SolveError(f"{problem}: there is no gait at this {special.type}")
    return special


def _follow(texts: list[str] | None) -> dict[str, int]:
    """Numbers by kind of ``--follow KIND=N``."""
    from gaitopt.cli.options import key_value
    from gaitopt.families.request import FOLLOWS

    counts = {}
    for text in texts or ():
        key, value = key_value(text, "--follow")
        if key not in FOLLOWS.values() or not value.isdecimal():
            kinds = ", ".join(f"{kind}=N" for kind in dict.fromkeys(FOLLOWS.values()))
            raise typer.BadParameter(f"--follow {text}: write --follow with one of {kinds} and a whole number N")
        counts[key] = int(value)
    return counts


def _number(text: str, option: str) -> float:
    """A number as YAML reads it, or an angle with its unit."""
    from gaitopt.errors import ProblemError
    from gaitopt.mechanics.units import parse_angle
    from gaitopt.problem import parse_value

    try:
        value = parse_value(text)
        return float(parse_angle(value))  # type: ignore[arg-type]
    except (ProblemError, ValueError, TypeError) as error:
        raise typer.BadParameter(f"{option} {text}: write a number, or an angle such as 2 deg") from error


def _walk(
    run: "BranchRun",
    start: "Gait | SpecialPoint",
    console: "Console",
    emit: Callable[[Mapping[str, Any]], None] | None,
) -> list[dict[str, Any]]:
    """Walk along the family and show each record; returns all of them, in short."""
    from gaitopt.cli.signals import interruptible

    with interruptible() as interrupted, _live(console, run.request.parameter) as show:
        done, to_come = run.walk(start, should_stop=interrupted)
        if done:
            console.print(f"taken up from {run.folder} after {len(done)} records", soft_wrap=True)
        summary = list[dict[str, Any]]()
        for record in chain(done, to_come):
            if len(summary) >= len(done):
                show(record)
            summary.append(_short(record))
            if emit:
                emit(record)
    return summary


def _short(record: Mapping[str, Any]) -> dict[str, Any]:
    """What the summary needs of a record, so that memory does not grow with the gaits."""
    keys = (
        "record",
        "branch",
        "index",
        "n_steps",
        "value",
        "type",
        "status",
        "reason",
        "next",
        "from",
        "to",
        "spectral_radius",
    )
    checked = record.get("type") == "end" and record["gait"].get("verification")
    short = {key: record[key] for key in keys if key in record} | {"refuted": bool(checked and not checked["passed"])}
    return short | {"sequence": _sequence(record)} if record["record"] == "point" else short


def _sequence(record: Mapping[str, Any]) -> str:
    from gaitopt.mechanics import Cycle

    steps = [str(step) for step in Cycle.from_record(record).steps]
    return f"{len(steps)} times {steps[0]}" if len(steps) > 1 and len(set(steps)) == 1 else " | ".join(steps)


@contextmanager
def _live(console: "Console", parameter: str) -> Iterator[Callable[[Mapping[str, Any]], None]]:
    """A line that follows the walk: a live one on a terminal, one per record elsewhere."""
    began, points = time.monotonic(), 0

    def words(record: Mapping[str, Any]) -> str:
        rate = points / max(time.monotonic() - began, 1e-9)
        radius = record["spectral_radius"]
        return (
            f"{parameter} = {record['value']:.6g}  |multiplier| {radius:.4f}  {_sequence(record)}  {rate:.0f} gaits/s"
        )

    def show(record: Mapping[str, Any]) -> None:
        nonlocal points
        if record["record"] == "special":
            console.print(f"  {parameter} = {record['value']:.9g}: {_event(record)}")
            return
        points += 1
        if console.is_terminal:
            status.update(words(record))
        else:
            console.print(f"  {words(record)}")

    with console.status("continuing") as status:
        yield show


def _joint(record: Mapping[str, Any]) -> str:
    """A special point with the branches that it leads to."""
    leads = f" -> {', '.join(map(str, record['next']))}" if record["next"] else ""
    return f"{record['type'].replace('_', ' ')}{leads}"


def _event(record: Mapping[str, Any]) -> str:
    name = record["type"].replace("_", " ")
    return name if not record.get("reason") else f"{name}: {record['reason']}"


def _print_summary(records: list[dict[str, Any]], folder: Path) -> None:
    """The branches, how they are joined, and what happens on them."""
    from rich.table import Table

    from gaitopt.cli.console import results
    from gaitopt.gait import TERMINAL
    from gaitopt.gait.cascade import cascades

    console = results()
    table = Table(title="Branches", title_justify="left")
    for heading in ("branch", "mode sequence", "from", "to", "points", "|multiplier|", "joints"):
        table.add_column(heading, overflow="fold")
    for number in sorted({record["branch"] for record in records}):
        points = [record for record in records if record["branch"] == number and record["record"] == "point"]
        if not points:
            continue
        radii = [point["spectral_radius"] for point in points]
        last = [record for record in records if record["branch"] == number and record["record"] == "special"]
        joints = [r for r in last if r["next"] or r["type"] in TERMINAL]
        joined = "; ".join(map(_joint, joints))
        table.add_row(
            str(number),
            points[0]["sequence"],
            f"{points[0]['value']:.6g}",
            f"{points[-1]['value']:.6g}",
            str(len(points)),
            f"{min(radii):.4f} to {max(radii):.4f}",
            joined,
        )
    console.print(table)
    for number, record in enumerate(record for record in records if record["record"] == "special"):
        guess = "" if record["status"] == "converged" else " (only bracketed)"
        console.print(f"{number}: branch {record['branch']}, {record['value']:.12g}{guess}: {_event(record)}")
    for cascade in cascades(records):
        console.print(f"cascade: {cascade}")
    console.print(f"run: {folder}", soft_wrap=True)
