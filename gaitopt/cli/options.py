"""The arguments and options that several commands take."""

from pathlib import Path
from typing import Annotated

import typer

ProblemArgument = Annotated[str, typer.Argument(metavar="PROBLEM", help="A name from `gaitopt list`, or a .yaml file.")]
RunArgument = Annotated[str, typer.Argument(metavar="RUN", help="A run folder, or a PROBLEM.")]
RunArguments = Annotated[list[str], typer.Argument(metavar="RUN...", help="Run folders, or PROBLEMs.")]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Change a value of the problem: friction=0.2, walker.slope='2 deg'."
    ),
]
GuessOption = Annotated[
    bool,
    typer.Option(
        "--from-guess",
        help="Solve changed problems from the guess of the file; by default the file's gait is followed to them.",
    ),
]
OutOption = Annotated[
    Path | None,
    typer.Option("-o", "--output", metavar="DIR", help="Run folder; by default results/NAME-HASH.", show_default=False),
]
EngineOption = Annotated[
    str, typer.Option("--engine", metavar="auto|scipy|heyoka", help="Integrator of the simulation; auto chooses.")
]
OverOption = Annotated[
    list[str], typer.Option("--over", metavar="KEY=LO:HI:N", help="N values of a key; repeat it for a grid.")
]
WorkersOption = Annotated[
    int | None,
    typer.Option("--workers", min=1, max=1024, help="Processes; by default one per core.", show_default=False),
]
SchedulerOption = Annotated[
    str | None, typer.Option("--scheduler", metavar="ADDRESS", help="An existing Dask scheduler, tcp://host:8786.")
]
SamplesOption = Annotated[
    int, typer.Option("--starts", min=1, max=1_000_000, help="Start states of the search by simulation.")
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Of the sampled guesses.")]
