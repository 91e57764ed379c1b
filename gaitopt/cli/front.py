"""``gaitopt front``: what one aim costs in terms of another, as a chain of verified designs."""

from typing import TYPE_CHECKING

import typer

from gaitopt.cli.grids import OverOption, grid, job_progress
from gaitopt.cli.options import DebugOption, JsonOption, OutOption, ProblemArgument, QuietOption, SetOption

if TYPE_CHECKING:
    from rich.console import Console

    from gaitopt.study.front import FrontPoint

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
    """Design along one number of the problem, in both directions, and mark the Pareto front."""
    from gaitopt.cli.console import narration, print_json, results
    from gaitopt.cli.progress import interruptible
    from gaitopt.cli.runs import asked
    from gaitopt.store import check_folder, json_text, run_folder, write_whole
    from gaitopt.store.files import make_folder
    from gaitopt.study.front import design_front

    axes, found = grid(over).axes, asked(problem, changes)
    if len(axes) != 1:
        raise typer.BadParameter("--over: a front runs along one key; give one --over KEY=LO:HI:N")
    folder = output or run_folder(found)
    check_folder(folder, found)
    with interruptible() as interrupted, job_progress(narration(quiet=quiet), "designs") as progress:
        points = design_front(found, axes[0], progress=progress, should_stop=interrupted)
        if interrupted():
            raise KeyboardInterrupt
    record = {"problem": found.name, "over": str(axes[0]), "points": [point.to_record() for point in points]}
    make_folder(folder)
    path = folder / f"front-{axes[0].key}.json"
    write_whole(path, json_text(record) + "\n")
    if json:
        print_json({**record, "file": str(path)})
    else:
        _print(results(), axes[0].key, points, str(path))
    return _exit_code(points)


def _exit_code(points: "list[FrontPoint]") -> int:
    verifications = [point.gait.verification for point in points if point.gait.converged]
    if not verifications:
        return NOT_A_GAIT
    return 0 if all(found is not None and found["passed"] for found in verifications) else NOT_VERIFIED


def _print(console: "Console", key: str, points: "list[FrontPoint]", path: str) -> None:
    for point in points:
        gait = point.gait
        if not gait.converged:
            console.print(f"{key} = {point.value:.6g}: {gait.status}: {gait.message}", soft_wrap=True)
            continue
        front = "front" if point.pareto else "beaten"
        checked = "verified" if gait.verification and gait.verification["passed"] else "REFUTED"
        speed, radius = gait.measures["speed"], gait.spectral_radius
        scalars = f"objective {gait.solver['objective']:.6g}, speed {speed:.4g} m/s, radius {radius:.4g}"
        console.print(f"{key} = {point.value:.6g}: {scalars}, {front}, {checked}", soft_wrap=True)
    console.print(f"front: {path}", soft_wrap=True)
