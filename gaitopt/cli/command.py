"""A command as Typer sees it: its argument ``terminal`` stands for the options --json, --quiet and --debug."""

from collections.abc import Callable
from functools import wraps
from inspect import Parameter, Signature, signature
from typing import Annotated, Any

import typer

from gaitopt.cli.terminal import Terminal

Shared = tuple[str, Any]
JSON: Shared = (
    "json",
    Annotated[bool, typer.Option("--json", help="Print one JSON object, floats to the last digit.")],
)
JSON_LINES: Shared = (
    "json",
    Annotated[bool, typer.Option("--json", help="Print one JSON object per line, as soon as it is found.")],
)
QUIET: Shared = ("quiet", Annotated[bool, typer.Option("--quiet", help="No narration and no progress on stderr.")])
DEBUG: Shared = ("debug", Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")])


def with_shared_options(command: Callable[..., int], *shared: Shared) -> Callable[..., int]:
    """The command with the ``shared`` options and --debug, which ``main`` reads, in place of ``terminal``."""
    options = [
        Parameter(name, Parameter.KEYWORD_ONLY, default=False, annotation=kind) for name, kind in (*shared, DEBUG)
    ]
    parameters = [entry for name, entry in signature(command).parameters.items() if name != "terminal"] + options

    @wraps(command)
    def run(**values: Any) -> int:
        given = {option.name: values.pop(option.name) for option in options}
        return command(**values, terminal=Terminal(json=given.get("json", False), quiet=given.get("quiet", False)))

    run.__annotations__ = {entry.name: entry.annotation for entry in parameters}
    run.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    return run
