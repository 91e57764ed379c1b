"""``gaitopt simulate``: walk forward from a state."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gaitopt.cli import values
from gaitopt.cli.options import EngineOption, OutOption, RunArgument, SetOption
from gaitopt.cli.runs import is_folder, load, stored_gait
from gaitopt.cli.signals import interruptible
from gaitopt.cli.terminal import Terminal

if TYPE_CHECKING:
    from gaitopt.study import Walk

STEP_BYTES_MEMORY, STEP_BYTES_DISK = 40_000, 20_000
"""Of the arcs of one step, in memory and as rows of a table."""

StateOption = Annotated[
    list[str] | None,
    typer.Option(
        "--state",
        metavar="NAME=VALUE,...",
        help="State just after an impact, where it differs from the problem's guess or the run's gait.",
    ),
]
StepsOption = Annotated[int, typer.Option("--steps", min=1, help="Steps to walk.")]


def simulate(
    terminal: Terminal,
    run: RunArgument,
    state: StateOption = None,
    steps: StepsOption = 1,
    engine: EngineOption = "auto",
    changes: SetOption = None,
    output: OutOption = None,
) -> int:
    """Simulate steps from a state.

    Contact modes and impacts follow from the forces; every ending has a name. `plot` and `report` of a walk that -o
    has kept compare it with the gait of RUN, or of PROBLEM where that has been solved.
    """
    from gaitopt import study
    from gaitopt.gait import Gait
    from gaitopt.library.print_gait import print_walk
    from gaitopt.library.stored import save
    from gaitopt.problem import Problem
    from gaitopt.runs.grid import check_room
    from gaitopt.store import check_folder

    start = stored_gait(run, changes)[0] if is_folder(run) else load(run, changes)
    begin = values.state(state)
    if output is not None:
        check_folder(output, start.problem if isinstance(start, Gait) else start)
    disk = 0 if output is None else STEP_BYTES_DISK
    check_room(steps, output or Path(), disk=disk, memory=STEP_BYTES_MEMORY, what="steps")
    terminal.say(f"walking {steps} step{'s' if steps > 1 else ''}")
    with interruptible() as interrupted:
        walk = study.simulate(start, begin, steps, engine=engine, should_stop=interrupted)
    walk = _compared(walk) if isinstance(start, Problem) else walk
    record = {**walk.to_record(), "run": None if output is None else str(output)}
    try:
        if output is not None:
            save(walk, output)
    finally:  # what was computed is printed even where it cannot be kept
        terminal.show(record, print_walk)
    return 0


def _compared(walk: "Walk") -> "Walk":
    """The walk of a problem beside its gait, where the store has one."""
    from gaitopt.store import is_complete, run_folder
    from gaitopt.study.simulate import section_states

    folder = run_folder(walk.problem)
    if not is_complete(folder):
        return walk
    return replace(walk, gait_states=section_states(stored_gait(str(folder), None)[0]))
