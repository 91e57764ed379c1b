"""``gaitopt find``: the gaits at a problem's parameters, of any mode sequence."""

from typing import Annotated

import typer

from gaitopt.cli.endings import NOT_A_GAIT
from gaitopt.cli.options import (
    OutOption,
    ProblemArgument,
    SamplesOption,
    SchedulerOption,
    SeedOption,
    SetOption,
    WorkersOption,
)
from gaitopt.cli.runs import load
from gaitopt.cli.terminal import Terminal
from gaitopt.cli.values import ranges

StepsOption = Annotated[int | None, typer.Option("--steps", min=1, help="Longest cycle, in steps.", show_default=False)]
WithinOption = Annotated[
    list[str] | None,
    typer.Option("--within", metavar="KEY=LO:HI", help="Range of a start coordinate, as dtheta1=0:1deg; repeat it."),
]


def find(
    terminal: Terminal,
    problem: ProblemArgument,
    steps: StepsOption = None,
    starts: SamplesOption = 1000,
    seed: SeedOption = 0,
    within: WithinOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    changes: SetOption = None,
    output: OutOption = None,
) -> int:
    """Search for all gaits at a problem's parameters, of any mode sequence.

    Walks from many start states and a program with open modes propose gaits; each is solved, verified and listed once,
    stable ones first. What is done is kept; the same command resumes where it stopped.
    """
    from gaitopt.library.print_results import print_gaits
    from gaitopt.runs.find_run import find_durably
    from gaitopt.search.find import SearchPlan, opened
    from gaitopt.store import run_folder
    from gaitopt.workers.jobs import make_workers

    loaded = opened(load(problem, changes))
    loaded = loaded if steps is None else loaded.replace({"gait.steps": steps})
    folder = output or run_folder(loaded)
    plan = SearchPlan(problem=loaded, starts=starts, seed=seed, within=ranges(within))
    parts_at = make_workers(workers, scheduler)
    with terminal.working("parts of the search") as (progress, interrupted):
        gaits = find_durably(plan, folder, parts_at, progress=progress, should_stop=interrupted)
    terminal.show({**gaits.to_record(), "run": str(folder)}, print_gaits, "run")
    return 0 if gaits else NOT_A_GAIT
