"""``gaitopt find``: the gaits at a problem's parameters, whatever their mode sequence."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from gaitopt.cli.grids import SchedulerOption, WorkersOption
from gaitopt.cli.options import (
    DebugOption,
    JsonOption,
    OutOption,
    ProblemArgument,
    QuietOption,
    SetOption,
    key_value,
)
from gaitopt.cli.starts import SeedOption

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rich.console import Console

NOTHING = 4

StartsOption = Annotated[int, typer.Option("--starts", min=1, help="Start states of the search by simulation.")]
StepsOption = Annotated[int | None, typer.Option("--steps", min=1, help="Longest cycle, in steps.", show_default=False)]
WithinOption = Annotated[
    list[str] | None,
    typer.Option("--within", metavar="KEY=LO:HI", help="Range of a start coordinate, as dtheta1=0:1deg; repeat it."),
]


def find(
    problem: ProblemArgument,
    steps: StepsOption = None,
    starts: StartsOption = 1000,
    seed: SeedOption = 0,
    within: WithinOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    changes: SetOption = None,
    output: OutOption = None,
    json: JsonOption = False,
    quiet: QuietOption = False,
    debug: DebugOption = False,
) -> int:
    """Search for all gaits at a problem's parameters, whatever their mode sequence.

    Walks from many start states and a program with open modes propose gaits; each is solved, verified and listed once,
    stable ones first. What is done is kept; the same command goes on where it was.
    """
    from gaitopt.cli.console import narration, print_json, results
    from gaitopt.cli.runs import load
    from gaitopt.cli.signals import interruptible
    from gaitopt.library.progress import job_progress
    from gaitopt.runs.find_run import find_durably
    from gaitopt.search.find import opened
    from gaitopt.store import begin_run, run_folder, writing
    from gaitopt.workers.jobs import make_workers

    console, loaded = narration(quiet=quiet), opened(load(problem, changes))
    loaded = loaded if steps is None else loaded.replace({"gait.steps": steps})
    folder = output or run_folder(loaded)
    spans, jobs_at = ranges(within), make_workers(workers, scheduler)
    with (
        writing(folder, loaded),
        interruptible() as interrupted,
        job_progress(console, "parts of the search") as progress,
    ):
        begin_run(folder, loaded)
        gaits = find_durably(
            loaded,
            folder,
            jobs_at,
            starts=starts,
            seed=seed,
            within=spans,
            progress=progress,
            should_stop=interrupted,
        )
    record = {**gaits.to_record(), "run": str(folder)}
    if json:
        print_json(record)
    else:
        print_gaits(results(), record)
    return 0 if gaits else NOTHING


def ranges(texts: "Sequence[str] | None") -> dict[str, tuple[float, float]]:
    """Ranges by name from ``--within`` options; angles may carry deg or rad.

    Raises
    ------
    typer.BadParameter
        If one is not of the form KEY=LO:HI, or a range is empty.
    """
    from gaitopt.runs.grid import number_or_angle

    spans = {}
    for text in texts or ():
        key, span = key_value(text, "--within")
        try:
            lower, upper = map(number_or_angle, span.split(":"))
        except ValueError as error:
            raise typer.BadParameter(f"--within {text}: write --within {key}=LO:HI ({error})") from error
        if not lower < upper:
            raise typer.BadParameter(f"--within {text}: an empty range, {lower:g} is not below {upper:g}")
        spans[key] = (lower, upper)
    return spans


def print_gaits(console: "Console", record: "Mapping[str, Any]") -> None:
    """One line per gait, and what was searched."""
    searched = record["searched"]
    tried = ", ".join(f"{count} of {method}" for method, count in searched["starts"].items())
    console.print(f"{record['problem']}: {len(record['gaits'])} gaits from {tried}", style="bold")
    if record["gaits"]:
        print_list(console, "gaits", record["gaits"])
    for lost in searched["rejected"]:
        console.print(f"no gait: {lost['sequence']}, from {len(lost['starts'])} starts: {lost['reason']}")
    for reason in searched["failed"]:
        console.print(f"a part of the search failed: {reason}")
    console.print(f"run: {record['run']}", soft_wrap=True)


def print_list(console: "Console", title: str, gaits: "Sequence[Mapping[str, Any]]") -> None:
    """One line per gait: sequence, steps, period, speed, radius, stability, and how many starts led there."""
    from gaitopt.library.quantities import number
    from gaitopt.library.tables import STABILITY, section
    from gaitopt.mechanics import Cycle

    columns = ("phases; impact", "steps", "period [s]", "speed [m/s]", "radius", "", "starts")
    rows = (
        (
            str(Cycle.from_record(gait)),
            str(gait["n_steps"]),
            number(gait["period"]),
            number(gait["speed"]),
            number(gait["spectral_radius"]),
            STABILITY[gait["spectral_radius"] < 1],
            str(len(gait["starts"])),
        )
        for gait in gaits
    )
    section(console, title, columns, rows, numbers=(1, 2, 3, 4, 6))
