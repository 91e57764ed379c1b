"""The options that the commands share, and how ``KEY=VALUE`` is read."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from gaitopt.errors import ProblemError

ProblemArgument = Annotated[str, typer.Argument(metavar="PROBLEM", help="A name from `gaitopt list`, or a .yaml file.")]
RunArgument = Annotated[str, typer.Argument(metavar="RUN", help="A run folder, or a PROBLEM.")]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Change a value of the problem: friction=0.2, walker.slope='2 deg'."
    ),
]
OutOption = Annotated[
    Path | None,
    typer.Option("-o", "--output", metavar="DIR", help="Run folder; by default results/NAME-HASH.", show_default=False),
]
EngineOption = Annotated[
    str, typer.Option("--engine", metavar="auto|scipy|heyoka", help="Integrator of the simulation; auto chooses.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object, floats to the last digit.")]
QuietOption = Annotated[bool, typer.Option("--quiet", help="No narration and no progress on stderr.")]
DebugOption = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]


def key_value(text: str, option: str) -> tuple[str, str]:
    """Split ``KEY=VALUE``.

    Raises
    ------
    typer.BadParameter
        If it is not of that form.
    """
    key, equals, value = text.partition("=")
    if not equals or not key.strip() or not value.strip():
        raise typer.BadParameter(f"{option} {text}: write {option} {key.strip() or 'KEY'}=VALUE")
    return key.strip(), value.strip()


def overrides(texts: Iterable[str] | None) -> dict[str, object]:
    """Values by dotted key from ``--set`` options, as YAML reads them; the last one counts.

    Raises
    ------
    ProblemError
        If a value is not YAML.
    """
    from gaitopt.problem import parse_value

    values: dict[str, object] = {}
    for key, text in (key_value(entry, "--set") for entry in texts or ()):
        try:
            values[key] = parse_value(text)
        except ProblemError as error:
            raise ProblemError(f"--set {key}: {error}") from error
    return values
