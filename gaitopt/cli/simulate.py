"""``gaitopt simulate``: walk from a state, whatever becomes of it."""

import math
from typing import Annotated

import typer

from gaitopt.cli.options import (
    DebugOption,
    EngineOption,
    JsonOption,
    OutOption,
    QuietOption,
    RunArgument,
    SetOption,
    key_value,
)

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
    run: RunArgument,
    state: StateOption = None,
    steps: StepsOption = 1,
    engine: EngineOption = "auto",
    changes: SetOption = None,
    output: OutOption = None,
    json: JsonOption = False,
    quiet: QuietOption = False,
    debug: DebugOption = False,
) -> int:
    """Simulate steps from a state.

    Contact modes and impacts follow from the forces; every ending has a name.
    """
    from gaitopt import study
    from gaitopt.cli.console import narration, print_json, results
    from gaitopt.cli.runs import is_folder, load, stored_gait
    from gaitopt.cli.signals import interruptible
    from gaitopt.gait import Gait
    from gaitopt.library.stored import save
    from gaitopt.library.tables import print_walk
    from gaitopt.store import check_folder

    start = stored_gait(run, changes)[0] if is_folder(run) else load(run, changes)
    begin = read_state(state)
    if output is not None:
        check_folder(output, start.problem if isinstance(start, Gait) else start)
    narration(quiet=quiet).print(f"walking {steps} step{'s' if steps > 1 else ''}")
    with interruptible() as interrupted:
        walk = study.simulate(start, begin, steps, engine=engine, should_stop=interrupted)
        if interrupted():
            raise KeyboardInterrupt
    record = {**walk.to_record(), "run": None if output is None else str(output)}
    try:
        if output is not None:
            save(walk, output)
    finally:  # what was computed is printed even where it cannot be kept
        if json:
            print_json(record)
        else:
            print_walk(results(), record)
    return 0


def read_state(texts: list[str] | None) -> dict[str, float]:
    """Numbers by state name from ``theta1=-0.15,dtheta1=0.7``; angles may carry deg or rad.

    Raises
    ------
    typer.BadParameter
        If a value is not a finite number.
    """
    from gaitopt.mechanics.units import parse_angle
    from gaitopt.problem import parse_value

    state: dict[str, float] = {}
    for entry in (entry for text in texts or () for entry in text.split(",") if entry.strip()):
        name, text = key_value(entry, "--state")
        try:
            value = parse_angle(parse_value(text))
        except ValueError as error:
            raise typer.BadParameter(f"--state {name}: {error}") from error
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise typer.BadParameter(f"--state {name}: {text} is not a finite number")
        state[name] = float(value)
    return state
