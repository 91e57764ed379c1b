"""``gaitopt front``: what one aim costs in terms of another, as a chain of verified designs."""

from typing import TYPE_CHECKING

import typer

from gaitopt.cli.grids import OverOption, grid
from gaitopt.cli.maps import DEFAULT_FORMATS, draw_front
from gaitopt.cli.options import DebugOption, JsonOption, OutOption, ProblemArgument, QuietOption, SetOption

if TYPE_CHECKING:
    from rich.console import Console

    from gaitopt.runs.front import FrontPoint

NOT_A_GAIT = 4
NOT_VERIFIED = 5


def front(
    problem: ProblemArgument,
    over: OverOption,
    changes: SetOption = None,
    output: OutOption = None,
    json: JsonOption = False,
    quiet: QuietOption = False,
    debug: DebugOption = False,
) -> int:
    """Design along one number of the problem, in both directions, and mark the Pareto front.

    Every design is kept as soon as it is found; the same command goes on where it was.
    """
    from gaitopt.cli.console import narration, print_json, results
    from gaitopt.cli.runs import load
    from gaitopt.cli.signals import interruptible
    from gaitopt.library.progress import job_progress
    from gaitopt.runs.front import check_front, design_front, front_file, front_record
    from gaitopt.store import adding, check_folder, run_folder, writing

    console = narration(quiet=quiet)
    axes, loaded = grid(over).axes, load(problem, changes, console)
    if len(axes) != 1:
        raise typer.BadParameter("--over: a front runs along one key; give one --over KEY=LO:HI:N")
    folder = output or run_folder(loaded)
    check_folder(folder, loaded)
    check_front(loaded, axes[0], folder)
    path = folder / front_file(axes[0].key)
    with writing(folder, loaded):
        with interruptible() as interrupted, job_progress(console, "designs") as progress:
            points = design_front(loaded, axes[0], folder, progress=progress, should_stop=interrupted)
        record = front_record(loaded, axes[0], points)
        with adding(folder, folder) as figures:
            figures += draw_front(loaded, axes[0].key, record["points"], DEFAULT_FORMATS, folder)
    if json:
        print_json({**record, "file": str(path), "figures": [str(path) for path in figures]})
    else:
        _print(results(), axes[0].key, points, str(path))
    return _exit_code(points)


def _exit_code(points: "list[FrontPoint]") -> int:
    verifications = [point.gait["verification"] for point in points if point.converged]
    if not verifications:
        return NOT_A_GAIT
    return 0 if all(entry["passed"] for entry in verifications) else NOT_VERIFIED


def _print(console: "Console", key: str, points: "list[FrontPoint]", path: str) -> None:
    for point in points:
        gait = point.gait
        if not point.converged:
            console.print(f"{key} = {point.value:.6g}: {gait['status']}: {gait['message']}", soft_wrap=True)
            continue
        front = "front" if point.pareto else "beaten"
        checked = "verified" if gait["verification"]["passed"] else "REFUTED"
        objective, speed, radius = gait["solver"]["objective"], gait["speed"], gait["spectral_radius"]
        scalars = f"objective {objective:.6g}, speed {speed:.4g} m/s, radius {radius:.4g}"
        console.print(f"{key} = {point.value:.6g}: {scalars}, {front}, {checked}", soft_wrap=True)
    console.print(f"front: {path}", soft_wrap=True)
