"""The program ``gaitopt``: its commands, its options for all commands, and the exit code of every ending."""

import gc
import os
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any

import typer

from gaitopt import __version__
from gaitopt.cli.families import atlas, attractors, basin, continue_, front, sweep, trace
from gaitopt.cli.gaits import explain, find, prove, replay, robustness, sensitivity, simulate, solve, stabilise, verify
from gaitopt.cli.terminal import (
    BROKEN_PIPE,
    INTERNAL_ERROR,
    STORAGE,
    USAGE,
    Terminal,
    allow_any_encoding,
    listening,
)
from gaitopt.cli.views import list_problems, plot, report, reproduce, schema, show, validate
from gaitopt.errors import ArgumentError, GaitoptError, GaitoptWarning, StorageError, printable

PREFIXES = {
    "over": "--over ",
    "parameter": "--param ",
    "key": "--param ",
    "to": "--to ",
    "what": "--what ",
    "engine": "--engine ",
    "setting": "--setting ",
}
"""Text before a message, by the argument of the library function that the error concerns."""
SUFFIXES = {"output": " with -o"}
"""Text after a message, by the argument of the library function that the error concerns."""
FLAGS = {"time_steps": "--dt", "parameter": "--param", "key": "--param"}
"""Name of the option for arguments of the library function that are called differently on the command line."""

Shared = tuple[str, Any]
JSON: Shared = (
    "json",
    Annotated[bool, typer.Option("--json", help="Print one JSON object, with floats in full precision.")],
)
JSON_LINES: Shared = (
    "json",
    Annotated[bool, typer.Option("--json", help="Print one JSON object per line, as soon as it is computed.")],
)
QUIET: Shared = ("quiet", Annotated[bool, typer.Option("--quiet", help="Suppress messages and progress on stderr.")])
ALL: Shared = ("all", Annotated[bool, typer.Option("--all", help="Print tables of many values whole.")])
DEBUG: Shared = ("debug", Annotated[bool, typer.Option("--debug", help="Print the traceback of an error.")])


OF_TERMINAL = {"json": "json", "quiet": "quiet", "all": "every"}
"""The argument of ``Terminal`` that each shared option sets."""


def with_shared_options(command: Callable[..., int], *shared: Shared) -> Callable[..., int]:
    """The function that Typer calls for a command: the ``shared`` options and --debug replace its ``terminal``."""
    options = [
        Parameter(name, Parameter.KEYWORD_ONLY, default=False, annotation=kind) for name, kind in (*shared, DEBUG)
    ]
    parameters = [entry for name, entry in signature(command).parameters.items() if name != "terminal"] + options

    @wraps(command)
    def run(**values: Any) -> int:
        given = {option.name: values.pop(option.name) for option in options}
        terminal = Terminal(**{OF_TERMINAL[name]: value for name, value in given.items() if name in OF_TERMINAL})
        return command(**values, terminal=terminal)

    run.__annotations__ = {entry.name: entry.annotation for entry in parameters}
    run.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    return run


COLLECT_AFTER = 100_000
"""Number of new objects between two garbage collections. Modules and compiled functions live until the command ends;
Python's default of 700 costs a tenth of the time of a command."""

VALUE_ERROR = "Value error, "
"""Start of messages by pydantic, which is left out."""
COMPLETION = "_GAITOPT_COMPLETE"
"""Environment variable with which a shell asks for completions; see ``--show-completion``."""


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
    """Find periodic gaits of planar legged walkers whose feet may slip, and verify them by simulation."""


for _name, _command, *_shared in (
    ("list", list_problems, JSON),
    ("show", show, JSON, ALL),
    ("validate", validate, JSON),
    ("schema", schema),
    ("solve", solve, JSON, QUIET, ALL),
    ("simulate", simulate, JSON, QUIET),
    ("verify", verify, JSON, QUIET),
    ("sensitivity", sensitivity, JSON, QUIET),
    ("robustness", robustness, JSON, QUIET),
    ("stabilise", stabilise, JSON, QUIET, ALL),
    ("find", find, JSON, QUIET),
    ("explain", explain, JSON, QUIET),
    ("continue", continue_, JSON_LINES, QUIET),
    ("trace", trace, JSON_LINES, QUIET),
    ("basin", basin, JSON, QUIET),
    ("atlas", atlas, JSON, QUIET),
    ("attractors", attractors, JSON_LINES, QUIET),
    ("sweep", sweep, JSON, QUIET),
    ("front", front, JSON, QUIET),
    ("prove", prove, JSON, QUIET),
    ("replay", replay, JSON_LINES, QUIET),
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
    gc.set_threshold(COLLECT_AFTER)
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments:
        main(["--help"])
        return USAGE
    allow_any_encoding()
    with listening() as received:
        try:
            _check_working_folder()
            with _shown_warnings():
                return _run(arguments)
        except GaitoptError as error:
            return _say(_message(error), error.exit_code, arguments)
        except typer.TyperException as error:
            command = getattr(getattr(error, "ctx", None), "command_path", "gaitopt")
            message = error.format_message().replace(VALUE_ERROR, "")
            return _say(f"{message} (see {command} --help)", error.exit_code, arguments)
        except KeyboardInterrupt:
            return _say(received.message, received.exit_code, arguments)
        except BrokenPipeError:
            # otherwise the interpreter would fail to flush stdout at its end
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return BROKEN_PIPE
        except OSError as error:
            if error.strerror is None:  # raised by a library, not by the system
                return _say(_internal_error(error), INTERNAL_ERROR, arguments)
            return _say(f"{error.strerror}: {error.filename or 'file or connection'}", STORAGE, arguments)
        except Exception as error:  # noqa: BLE001 - the last resort, so that no traceback reaches a user unasked
            if received:  # compiled code has turned the interrupt into an error of its own
                return _say(received.message, received.exit_code, arguments)
            return _say(_internal_error(error), INTERNAL_ERROR, arguments)


def _check_working_folder() -> None:
    """Refuse to work in a folder that has been deleted."""
    try:
        Path.cwd()
    except FileNotFoundError as error:
        raise StorageError("the working directory has been deleted; change to another one") from error


@contextmanager
def _shown_warnings() -> Iterator[None]:
    """Print gaitopt's own warnings on stderr, one line each; other warnings are shown as usual."""
    with warnings.catch_warnings():
        elsewhere = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *location: Any, **details: Any) -> None:
            if issubclass(category, GaitoptWarning):
                sys.stderr.write(printable(f"gaitopt: warning: {message}\n"))
            else:
                elsewhere(message, category, *location, **details)

        warnings.showwarning = show
        warnings.simplefilter("always", GaitoptWarning)
        yield


def _message(error: GaitoptError) -> str:
    """The message of an error, with the option that it concerns."""
    if isinstance(error, ArgumentError):
        return f"{FLAGS.get(error.argument) or '--' + error.argument.replace('_', '-')} {error.fault}"
    prefix, suffix = PREFIXES.get(error.argument, ""), SUFFIXES.get(error.argument, "")
    return "\n".join(prefix + line for line in str(error).splitlines()) + suffix


def _internal_error(error: Exception) -> str:
    """One line about a bug: the exception and its location, because some exceptions have no message."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    description = ": ".join(filter(None, (type(error).__name__, str(error))))
    file = "/".join(Path(frame.filename).parts[-2:])
    return f"internal error: {description} ({file}:{frame.lineno}); rerun with --debug for the traceback"


def _run(arguments: list[str]) -> int:
    if COMPLETION in os.environ:
        app(prog_name="gaitopt")
    try:
        with _commands().make_context("gaitopt", list(arguments)) as context:
            code = context.command.invoke(context)
    except typer.Exit as ending:  # --help, --version, or a gait that was not found
        code = ending.exit_code
    sys.stdout.flush()
    return int(code)


@cache
def _commands() -> Any:
    """The parser of all commands, built once because that takes a while."""
    return typer.main.get_command(app)


def _say(message: str, code: int, arguments: list[str]) -> int:
    """Print an error on stderr; with --debug its traceback before it."""
    if "--debug" in arguments:
        sys.stderr.write(printable(traceback.format_exc()))
    sys.stderr.write(printable(f"gaitopt: {message}\n"))
    return code
