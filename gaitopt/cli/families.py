"""Commands that compute many gaits or many walks: ``continue``, ``trace``, ``front``, ``sweep``, ``atlas``, ...

Results are stored as soon as they are computed; a repeated command resumes.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

import gaitopt as go
from gaitopt.cli import options
from gaitopt.cli.runs import gait_of, load
from gaitopt.cli.terminal import NOT_A_GAIT, NOT_VERIFIED, Terminal, interruptible
from gaitopt.errors import UnknownNameError
from gaitopt.requests import (
    AtlasRequest,
    AttractorsRequest,
    BasinRequest,
    ContinueRequest,
    Engine,
    FloorRequest,
    SweepRequest,
    TraceRequest,
)

if TYPE_CHECKING:
    from gaitopt.gait.branch import SpecialPoint
    from gaitopt.gait.gait import Gait
    from gaitopt.runs.atlas import Atlas
    from gaitopt.runs.basin import Basin
    from gaitopt.runs.sweep import Sweep


Record = Mapping[str, Any]

SHOWN = ("record", "branch", "n_steps", "value", "type", "status", "reason", "next", "spectral_radius")
TRACED = ("record", "curve", "values", "type", "status", "reason", "next", "coefficients")
"""Keys of the records of a branch and of a trace that lines and summary show. The rest does not stay in memory."""


def continue_(
    terminal: Terminal,
    problem: Annotated[
        str,
        typer.Argument(
            metavar="PROBLEM",
            help="A name, a .yaml file, the run folder of a gait, or RUN@special.K for the other branches through the "
            "K-th special point of a branch, or in another parameter for its gait.",
        ),
    ],
    param: Annotated[str, options.option(ContinueRequest, "parameter", "--param", metavar="KEY")],
    to: Annotated[list[float], options.option(ContinueRequest, "to", metavar="VALUE")],
    lower: Annotated[float | None, options.option(ContinueRequest, "lower", metavar="VALUE")] = None,
    upper: Annotated[float | None, options.option(ContinueRequest, "upper", metavar="VALUE")] = None,
    max_points: Annotated[int, options.option(ContinueRequest, "max_points")] = 2000,
    max_seconds: Annotated[float | None, options.option(ContinueRequest, "max_seconds")] = None,
    verify_every: Annotated[int, options.option(ContinueRequest, "verify_every")] = 10,
    follow: Annotated[
        list[str] | None,
        typer.Option(
            "--follow",
            metavar="KIND=N",
            help="Also follow the other branches that begin at special points, up to N levels deep; KIND is doublings, "
            "branch_points or mode_changes. May be repeated.",
        ),
    ] = None,
    changes: options.SetOption = None,
    output: options.OutOption = None,
) -> int:
    """Follow the family of a gait along a parameter.

    The branch passes folds and changes of the mode sequence, and special points are located on it.

    RUN@special.K follows the other branches through a special point: cycles with twice as many steps at a period
    doubling, the crossing curve at a branch point, other mode sequences at a mode change. In another parameter
    than that of its branch, the gait at the special point is continued.
    Every point is stored as soon as it is found. Repeat the command to resume.
    """
    from gaitopt.api import stored
    from gaitopt.branches.request import check_parameter
    from gaitopt.show.tables import print_branch

    levels = options.counts(follow)
    start: Gait | SpecialPoint
    if stored.SPECIAL in problem:
        if changes:
            raise typer.BadParameter(
                f"--set changes a problem, but {problem} is a point of a finished run; leave it out"
            )
        start, _ = stored.load_special_point(problem)
        gait = start.gait
    else:
        check = partial(check_parameter, key=param)
        gait, _, _ = gait_of(problem, changes, None, terminal, keep=False, required=True, check=check)
        start = gait
    with interruptible() as interrupted:
        records = go.continuation_records(
            start, param, to, lower=lower, upper=upper, max_points=max_points, max_seconds=max_seconds,
            verify_every=verify_every, output=output, should_stop=interrupted, **levels,
        )  # fmt: skip
        head, summary = _followed(records, SHOWN, "continuing", terminal)
    if not terminal.json:
        print_branch(terminal.results, summary, param, None if gait is None else gait.problem)
        terminal.results.print(f"run: {head['folder']}", soft_wrap=True)
    ends = [record["verification"] for record in summary if record.get("type") == "end"]
    return NOT_VERIFIED if any(checked and not checked["passed"] for checked in ends) else 0


def _followed(
    records: Iterator[dict[str, Any]], kept: Sequence[str], what: str, terminal: Terminal
) -> tuple[Record, list[dict[str, Any]]]:
    """Show the new ones of stored records, and print all of them as JSON lines with ``--json``.

    Points are shown in a live line on a terminal that begins with ``what``, and in lines of their own elsewhere.

    Returns
    -------
    head : the first record, the request.
    summary : the entries ``kept`` of the other records, with the mode sequence of points and the verification of
        special points.
    """
    from gaitopt.show.tables import event, sequence

    console, began, points = terminal.narration, time.monotonic(), 0
    with console.status(what) as status:
        head, summary = next(records), list[dict[str, Any]]()
        if head["stored"]:
            terminal.say(f"resumed from {head['folder']} after {head['stored']} records")
        for record in records:
            shown = {key: record[key] for key in kept if key in record}
            summary.append(shown)
            values = record.get("values") or {head["parameter"]: record["value"]}
            point = ", ".join(f"{key} = {value:.9g}" for key, value in values.items())
            if record["record"] == "special":
                shown["verification"] = record["gait"].get("verification")
                line = f"{point}: {event(record)}"
            else:
                shown["sequence"] = sequence(record)
                line = f"{point}  |multiplier| {record['spectral_radius']:.4f}  {shown['sequence']}"
            is_new = len(summary) > head["stored"]
            if is_new and record["record"] == "point" and console.is_terminal:
                points += 1
                status.update(f"{line}  {points / max(time.monotonic() - began, 1e-9):.0f} gaits/s")
            elif is_new:
                terminal.say(f"  {line}")
            if terminal.json:
                terminal.print_json(record)
    return head, summary


def trace(
    terminal: Terminal,
    run: Annotated[
        str,
        typer.Argument(
            metavar="RUN@special.K[.N]",
            help="The K-th special point of a branch; or of a trace, for the N-th curve that begins there, by default "
            "the first one (0).",
        ),
    ],
    param: Annotated[str, options.option(TraceRequest, "key", "--param", metavar="KEY")],
    to: Annotated[list[float], options.option(TraceRequest, "to", metavar="VALUE")],
    lower: Annotated[float | None, options.option(TraceRequest, "lower", metavar="VALUE")] = None,
    upper: Annotated[float | None, options.option(TraceRequest, "upper", metavar="VALUE")] = None,
    max_points: Annotated[int, options.option(TraceRequest, "max_points")] = 2000,
    max_seconds: Annotated[float | None, options.option(TraceRequest, "max_seconds")] = None,
    verify_every: Annotated[int, options.option(TraceRequest, "verify_every")] = 10,
    output: options.OutOption = None,
) -> int:
    """Follow a special point of a branch in two parameters.

    Folds, period doublings, Neimark-Sacker points and changes of the mode sequence are followed. Codimension-two points
    are located on the curve, with the normal form of its bifurcation and the curves that begin there.
    Every point is stored as soon as it is found. Repeat the command to resume.
    """
    from gaitopt.api import stored
    from gaitopt.show.tables import print_trace

    start = stored.load_curve_start(run)
    with interruptible() as interrupted:
        records = go.trace_records(
            start, param, to, lower=lower, upper=upper, max_points=max_points, max_seconds=max_seconds,
            verify_every=verify_every, output=output, should_stop=interrupted,
        )  # fmt: skip
        head, summary = _followed(records, TRACED, "tracing", terminal)
    if not terminal.json:
        print_trace(terminal.results, summary, (head["parameter"], head["key"]))
        terminal.results.print(f"run: {head['folder']}", soft_wrap=True)
    refuted = any(s["record"] == "special" and s["reason"].startswith("the simulator disagrees") for s in summary)
    return NOT_VERIFIED if refuted else 0


def front(
    terminal: Terminal,
    problem: options.ProblemArgument,
    over: options.OverOption,
    changes: options.SetOption = None,
    output: options.OutOption = None,
) -> int:
    """Solve a series of designs along one key, such as least cost versus speed.

    The values are solved upwards and downwards, each from the design at the previous value. The designs that no other
    design beats form the Pareto front. Every design is stored as soon as it is found. Repeat the command to resume.
    """
    from gaitopt.gait.records import is_gait
    from gaitopt.show.tables import print_front

    ranges, loaded = options.grid(over), load(problem, changes, terminal)
    with terminal.working("designs") as (progress, interrupted):
        designs = go.front(loaded, ranges, output=output, progress=progress, should_stop=interrupted)
    figures = go.save_figures(designs, designs.file.parent) if designs.file is not None else []
    record = {**designs.to_record(), "file": str(designs.file), "figures": [str(figure) for figure in figures]}
    terminal.show(record, print_front, "file")
    gaits = [point.gait for point in designs if is_gait(point.gait)]
    if not gaits:
        return NOT_A_GAIT
    return 0 if all(gait["verification"] and gait["verification"]["passed"] for gait in gaits) else NOT_VERIFIED


def sweep(
    terminal: Terminal,
    problem: options.ProblemArgument,
    over: options.GridOption,
    warm: Annotated[bool, options.option(SweepRequest, "warm")] = False,
    what: Annotated[str, typer.Option("--what", metavar="NAME", help="Scalar to draw.")] = "spectral_radius",
    workers: options.WorkersOption = None,
    scheduler: options.SchedulerOption = None,
    changes: options.SetOption = None,
    from_guess: options.GuessOption = False,
    method: options.MethodOption = "auto",
    output: options.OutOption = None,
) -> int:
    """Solve and verify a problem on a grid of parameters.

    Each point is solved as `solve --set` does. A point without a gait is recorded with its reason. Every result is
    stored as soon as it is found. Repeat the command to resume.
    """
    from gaitopt.problem.scalars import SCALARS
    from gaitopt.runs.sweep import TABLE_FILE
    from gaitopt.show.tables import print_sweep

    if what not in SCALARS:
        raise UnknownNameError(f"--what {what}: no scalar of a sweep; use {', '.join(SCALARS)}")
    ranges, loaded = options.grid(over), load(problem, changes, terminal)
    with terminal.working("jobs") as (progress, interrupted):
        swept = go.sweep(
            loaded, ranges, warm=warm, from_guess=from_guess, method=method, workers=workers, scheduler=scheduler,
            output=output, progress=progress, should_stop=interrupted,
        )  # fmt: skip
    paths = {"table": f"{swept.folder}/{TABLE_FILE}", "run": str(swept.folder)}
    terminal.show({**swept.to_record(), **paths, **_drawn(swept, [what])}, print_sweep, "table")
    return 0


def atlas(
    terminal: Terminal,
    problem: options.ProblemArgument,
    over: Annotated[
        list[str],
        typer.Option(
            "--over", metavar="KEY=LO:HI", help="Range of a parameter; give it twice, first that of the branches."
        ),
    ],
    slices: Annotated[int, options.option(AtlasRequest, "slices")] = 9,
    refinements: Annotated[int, options.option(AtlasRequest, "refinements")] = 3,
    max_points: Annotated[int, options.option(AtlasRequest, "max_points")] = 400,
    steps: Annotated[int | None, options.option(AtlasRequest, "steps")] = None,
    what: Annotated[
        str | None, typer.Option("--what", metavar="NAME", help="Scalar to draw as contours.", show_default=False)
    ] = None,
    workers: options.WorkersOption = None,
    scheduler: options.SchedulerOption = None,
    changes: options.SetOption = None,
    output: options.OutOption = None,
) -> int:
    """Find where gaits exist, slip and are stable over two parameters.

    Branches in the first parameter at some values of the second, and the curves of their special points, bound regions
    of one mode sequence and stability. A gait in each region is verified. Repeat the command to resume.
    """
    from gaitopt.problem.scalars import SCALARS
    from gaitopt.show.tables import print_atlas

    if what is not None and what not in SCALARS:
        raise UnknownNameError(f"--what {what}: no scalar of a gait; use {', '.join(SCALARS)}")
    spans, loaded = options.intervals(over), load(problem, changes, terminal)
    with terminal.working("branches and curves") as (progress, interrupted):
        found = go.atlas(
            loaded, spans, slices=slices, refinements=refinements, max_points=max_points, steps=steps, workers=workers,
            scheduler=scheduler, output=output, progress=progress, should_stop=interrupted,
        )  # fmt: skip
    pictures = [] if what is None else [what]
    terminal.show({**found.to_record(), "run": str(found.folder), **_drawn(found, pictures)}, print_atlas, "run")
    return 0


def attractors(
    terminal: Terminal,
    problem: options.ProblemArgument,
    over: options.OverOption,
    starts: Annotated[int, options.option(AttractorsRequest, "starts")] = 20,
    transient: Annotated[int, options.option(AttractorsRequest, "transient")] = 200,
    keep: Annotated[int, options.option(AttractorsRequest, "keep")] = 64,
    seed: options.SeedOption = 0,
    engine: options.EngineOption = "auto",
    workers: options.WorkersOption = None,
    scheduler: options.SchedulerOption = None,
    changes: options.SetOption = None,
    output: options.OutOption = None,
) -> int:
    """Find the attractors of a walker at many values of a parameter.

    Long walks from several starts settle on cycles of any length, or on chaos, where the largest Lyapunov exponent
    per step is positive. Finished values are stored; repeat the command to resume. `gaitopt plot FOLDER --over RUN`
    draws the diagram over a branch.
    """
    from gaitopt.show.tables import print_attractors

    ranges, loaded = options.grid(over), load(problem, changes, terminal)
    with terminal.working("values") as (progress, interrupted):
        result = go.attractors(
            loaded, ranges, starts=starts, transient=transient, keep=keep, seed=seed, engine=engine, workers=workers,
            scheduler=scheduler, output=output, progress=progress, should_stop=interrupted,
        )  # fmt: skip
    if terminal.json:
        for record in result.to_records():
            terminal.print_json(record)
        return 0
    print_attractors(terminal.results, result)
    terminal.results.print(f"run: {result.folder}", soft_wrap=True)
    return 0


def basin(
    terminal: Terminal,
    run: options.RunArgument,
    over: options.GridOption,
    steps: Annotated[int, options.option(BasinRequest, "steps")] = 100,
    engine: options.EngineOption = "auto",
    floor: Annotated[str | None, options.option(FloorRequest, "floor", metavar="TILES")] = None,
    random: Annotated[str | None, options.option(FloorRequest, "random", metavar="DISTRIBUTION")] = None,
    seed: options.SeedOption = 0,
    workers: options.WorkersOption = None,
    scheduler: options.SchedulerOption = None,
    changes: options.SetOption = None,
    output: options.OutOption = None,
) -> int:
    """Compute basins of attraction on a grid of states.

    From each state a walk is simulated until it settles on a gait or fails. The other coordinates are those of the
    gait of RUN. Finished tiles are stored; repeat the command to resume. `gaitopt solve RUN@attractor.K` solves the
    gait of the K-th attractor; RUN is then the folder that basin prints.
    """
    from gaitopt.runs.basin import check_keys
    from gaitopt.show.tables import print_basin
    from gaitopt.simulation.engine import INSTALL, choose_engine, is_installed

    ranges, tiles = options.grid(over), options.floor(floor, random, seed, steps)
    choose_engine(engine)
    gait, folder, fresh = gait_of(run, changes, output, terminal, check=partial(check_keys, keys=ranges))
    if fresh and not gait.converged:
        terminal.say(f"{gait.problem.name} is {gait.status}; the grid is centred on its guess")
    if engine == Engine.AUTO and not is_installed():
        terminal.say(f"simulating on scipy; heyoka is several times as fast: {INSTALL}")
    with terminal.working("tiles") as (progress, interrupted):
        result = go.basin(
            gait if gait.converged else gait.problem, ranges, steps=steps, engine=engine, floor=tiles,
            workers=workers, scheduler=scheduler, output=output or folder, progress=progress, should_stop=interrupted,
        )  # fmt: skip
    record = {**result.to_record(), "run": str(result.folder), **_drawn(result, ())}
    terminal.show(record, print_basin, "run")
    return 0


def _drawn(result: "Sweep | Basin | Atlas", what: Sequence[str]) -> dict[str, list[str]]:
    """Draw an atlas, or a sweep or basin over few keys, into its folder; returns ``figures`` of its record."""
    from gaitopt.runs.atlas import Atlas
    from gaitopt.show.catalogue import DRAWN_AXES

    axes = result.axes if isinstance(result, Atlas) else result.grid.axes
    if result.folder is None or len(axes) > DRAWN_AXES:
        return {}
    return {"figures": [str(path) for path in go.save_figures(result, result.folder, what)]}
