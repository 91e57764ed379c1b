"""``gaitopt front``: what one aim costs in terms of another, as a chain of verified designs."""

import typer

from gaitopt.cli.endings import NOT_A_GAIT, NOT_VERIFIED
from gaitopt.cli.figures import save_figures
from gaitopt.cli.options import OutOption, OverOption, ProblemArgument, SetOption
from gaitopt.cli.runs import load
from gaitopt.cli.terminal import Terminal
from gaitopt.cli.values import grid


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
    from gaitopt.figures.catalogue import front_figures
    from gaitopt.library.print_results import print_front
    from gaitopt.runs.front import check_front, design_front, front_file, front_record
    from gaitopt.store import adding, check_folder, run_folder, writing

    axes, loaded = grid(over).axes, load(problem, changes, terminal)
    if len(axes) != 1:
        raise typer.BadParameter("--over: a front runs along one key; give one --over KEY=LO:HI:N")
    folder = output or run_folder(loaded)
    check_folder(folder, loaded)
    check_front(loaded, axes[0], folder)
    path = folder / front_file(axes[0].key)
    with writing(folder, loaded):
        with terminal.working("designs") as (progress, interrupted):
            designs = design_front(loaded, axes[0], folder, progress=progress, should_stop=interrupted)
        with adding(folder, folder) as figures:
            figures += save_figures(front_figures(designs), folder)
    terminal.show(
        {**front_record(designs, axes[0]), "file": str(path), "figures": [str(figure) for figure in figures]},
        print_front,
        "file",
    )
    verifications = [point.gait["verification"] for point in designs if point.converged]
    if not verifications:
        return NOT_A_GAIT
    return 0 if all(entry["passed"] for entry in verifications) else NOT_VERIFIED
