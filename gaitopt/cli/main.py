"""The commands, and the one place where an ending becomes an exit code.

A command as Typer sees it: its argument ``terminal`` stands for the options --json, --quiet and --debug.
"""

import gc
import os
import sys
from collections.abc import Callable, Sequence
from functools import cache, wraps
from inspect import Parameter, Signature, signature
from typing import Annotated, Any

import typer

from gaitopt import __version__
from gaitopt.cli.families import basin, continue_, front, sweep
from gaitopt.cli.gaits import explain, find, simulate, solve, verify
from gaitopt.cli.pictures import plot, report, reproduce
from gaitopt.cli.problems import list_problems, schema, show, validate
from gaitopt.cli.prove import prove
from gaitopt.cli.terminal import (
    BROKEN_PIPE,
    INTERNAL_ERROR,
    STORAGE,
    USAGE,
    Terminal,
    allow_any_encoding,
    check_working_folder,
    error_words,
    internal_error,
    listening,
    printable,
    shown_warnings,
)
from gaitopt.errors import GaitoptError

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


LASTING = 100_000
"""New objects between two searches for cycles of them: modules and compiled functions last as long as the command does,
and looking through them after every 700 takes a tenth of its time."""

COMPLETION = "_GAITOPT_COMPLETE"
"""Variable through which a shell that completes a command line asks for words; see ``--show-completion``."""


def print_version(requested: bool) -> None:
    """Print the version and end, if ``--version`` is given."""
    if requested:
        sys.stdout.write(f"gaitopt {__version__}\n")
        raise typer.Exit


VersionOption = Annotated[
    bool, typer.Option("--version", callback=print_version, is_eager=True, help="Print the version and exit.")
]

app = typer.Typer(
    name="gaitopt",
    epilog="PROBLEM is a name from `gaitopt list` or a .yaml file; RUN is a run folder, or a PROBLEM.",
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode=None,
)


@app.callback()
def options(version: VersionOption = False) -> None:
    """Periodic gaits of legged walkers that slip: solved, simulated, verified."""


for _name, _command, *_shared in (
    ("list", list_problems, JSON),
    ("show", show, JSON),
    ("validate", validate, JSON),
    ("schema", schema),
    ("solve", solve, JSON, QUIET),
    ("simulate", simulate, JSON, QUIET),
    ("verify", verify, JSON, QUIET),
    ("find", find, JSON, QUIET),
    ("explain", explain, JSON, QUIET),
    ("continue", continue_, JSON_LINES, QUIET),
    ("basin", basin, JSON, QUIET),
    ("sweep", sweep, JSON, QUIET),
    ("front", front, JSON, QUIET),
    ("prove", prove, JSON, QUIET),
    ("plot", plot, QUIET),
    ("report", report, QUIET),
    ("reproduce", reproduce, QUIET),
):
    app.command(_name)(with_shared_options(_command, *_shared))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Parameters
    ----------
    argv : arguments without the program's name; those of the process if None.
    """
    gc.set_threshold(LASTING)
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments:
        main(["--help"])
        return USAGE
    allow_any_encoding()
    with listening() as ending:
        try:
            check_working_folder()
            with shown_warnings():
                return _run(arguments)
        except GaitoptError as error:
            return _say(error_words(error), error.exit_code, arguments)
        except typer.TyperException as error:
            command = getattr(getattr(error, "ctx", None), "command_path", "gaitopt")
            return _say(f"{error.format_message()} (see {command} --help)", error.exit_code, arguments)
        except KeyboardInterrupt:
            return _say(ending.words, ending.exit_code, arguments)
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or the interpreter complains at its end
            return BROKEN_PIPE
        except OSError as error:
            if error.strerror is None:  # raised by a library, not by the system
                return _say(internal_error(error), INTERNAL_ERROR, arguments)
            return _say(f"{error.strerror}: {error.filename or 'file or connection'}", STORAGE, arguments)
        except Exception as error:  # noqa: BLE001 - the last resort, so that no traceback reaches a user unasked
            if ending:  # compiled code has made an error of its own of the interrupt
                return _say(ending.words, ending.exit_code, arguments)
            return _say(internal_error(error), INTERNAL_ERROR, arguments)


def _run(arguments: list[str]) -> int:
    if COMPLETION in os.environ:
        app(prog_name="gaitopt")
    try:
        with _commands().make_context("gaitopt", list(arguments)) as context:
            code = context.command.invoke(context)
        sys.stdout.flush()
    except typer.Exit as ending:  # --help, --version
        return ending.exit_code
    return int(code)


@cache
def _commands() -> Any:
    """The parser of all commands, which takes a while to build."""
    return typer.main.get_command(app)


def _say(message: str, code: int, arguments: list[str]) -> int:
    """Print an error on stderr; with --debug its traceback before it."""
    if "--debug" in arguments:
        import traceback

        sys.stderr.write(printable(traceback.format_exc()))
    sys.stderr.write(printable(f"gaitopt: {message}\n"))
    return code
