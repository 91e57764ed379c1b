"""``gaitopt prove``: rigorous bounds for a gait, its mode sequence and its multipliers; certificates checked again."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gaitopt.cli.runs import SPECIAL, gait_of, report, special_records
from gaitopt.cli.terminal import NOT_A_GAIT, Terminal
from gaitopt.cli.values import OutOption, SetOption, key_value
from gaitopt.errors import ProblemError, StorageError, UnknownNameError

if TYPE_CHECKING:
    from rich.console import Console

    from gaitopt.proof.theorem import Proof


CERTIFICATE_FILE = "proof.json"
NARROWEST, WIDEST = 1e-14, 1.0
"""Bounds of ``--width``: doubles resolve no narrower bracket, and no special point needs a wider one."""
MOST_DIGITS = 9
"""Of the number of a special point."""

TargetArgument = Annotated[
    str,
    typer.Argument(
        metavar="RUN[@special.K]",
        help="A run folder, or a PROBLEM; the K-th special point of a branch, from 0; with --check a certificate.",
    ),
]
WidthOption = Annotated[
    float | None,
    typer.Option(
        "--width",
        help="Width of the bracket of a special point, from 1e-14 to 1; the narrowest that can be proved if left out.",
    ),
]
CheckOption = Annotated[bool, typer.Option("--check", help="Verify a certificate again, without any search.")]


def prove(
    terminal: Terminal,
    run: TargetArgument,
    check: CheckOption = False,
    width: WidthOption = None,
    changes: SetOption = None,
    output: OutOption = None,
) -> int:
    """Prove that a gait exists, and what it does.

    Ball arithmetic encloses the orbit, its mode sequence and its multipliers; the certificate is kept with the run.
    Of a special point it proves the family around it, and that what defines it changes its sign.
    """
    if check:
        if changes or output is not None:
            raise typer.BadParameter("--check reads a certificate and nothing else; leave out --set and -o")
        return _report(_checked(Path(run)), Path(run), terminal)
    if width is not None and not NARROWEST <= width <= WIDEST:
        raise typer.BadParameter(f"--width {width:g} is not between {NARROWEST:g} and {WIDEST:g}")
    if SPECIAL in run:
        if changes:
            raise typer.BadParameter("--set changes a problem, but a branch is what it is; leave it out")
        return _prove_special(run, width, output, terminal)
    if width is not None:
        raise typer.BadParameter("--width is that of the bracket of a special point, RUN@special.K")
    return _prove(run, changes, output, terminal)


def _prove(run: str, changes: list[str] | None, output: Path | None, terminal: Terminal) -> int:
    from gaitopt.api.stored import save
    from gaitopt.proof.prove import prove as prove_gait

    changes, intervals = _intervals(changes)
    gait, folder, fresh = gait_of(run, changes, output, terminal)
    if not gait.converged:
        return report(gait, None, terminal)
    if fresh:
        save(gait, folder)
    terminal.say(f"proving {gait.problem.name}: ten seconds to some minutes")
    return _keep(prove_gait(gait, intervals, progress=terminal.say), folder / CERTIFICATE_FILE, terminal)


def _prove_special(target: str, width: float | None, output: Path | None, terminal: Terminal) -> int:
    from gaitopt import solve
    from gaitopt.problem.faults import shown
    from gaitopt.proof.prove import prove_special
    from gaitopt.proof.theorem import BRACKETED

    run, _, number = target.rpartition(SPECIAL)
    problem, parameter, records = special_records(run)
    if not number.isdecimal() or len(number) > MOST_DIGITS or int(number) >= len(records):
        raise UnknownNameError(f"{run} has no special point {shown(number)}; it has {len(records)}, from 0")
    special = records[int(number)]
    kind = special["type"]
    if kind not in BRACKETED or not special["gait"]:
        raise UnknownNameError(f"{target} is of type {kind}; {', '.join(BRACKETED)} can be proved")
    gait = solve(problem.with_gait(special["gait"]).replace({parameter: special["value"]}))
    if not gait.converged:
        return report(gait, None, terminal)
    terminal.say(f"proving {kind} of {gait.problem.name} near {parameter} = {special['value']:.9g}: some minutes")
    proof = prove_special(gait, parameter, kind, width, progress=terminal.say)
    folder = output or Path(run)
    folder.mkdir(parents=True, exist_ok=True)
    return _keep(proof, folder / f"special-{number}-{CERTIFICATE_FILE}", terminal)


def _keep(proof: "Proof", file: Path, terminal: Terminal) -> int:
    from gaitopt.store.files import json_text, write_whole

    write_whole(file, json_text({**proof.certificate, "theorem": proof.to_record()}) + "\n")
    return _report(proof, file, terminal)


def _intervals(changes: list[str] | None) -> tuple[list[str] | None, dict[str, str]]:
    """``--set`` with the middle of every interval, and the intervals ``KEY=LO..HI`` by key."""
    from gaitopt.proof.arithmetic import INTERVAL, ball, precision

    pairs = [key_value(text, "--set") for text in changes or ()]
    intervals = {key: text for key, text in pairs if INTERVAL in text}
    try:
        with precision():
            middles = {key: repr(float(ball(text).mid())) for key, text in intervals.items()}
    except ValueError as error:
        raise ProblemError(f"--set {', '.join(intervals)}: {error}") from error
    return [f"{key}={middles.get(key, text)}" for key, text in pairs] or None, intervals


def _checked(file: Path) -> "Proof":
    from gaitopt.proof.certificate import parse_certificate
    from gaitopt.proof.check import check

    content = _read(file)
    try:
        return check(parse_certificate(content))
    except StorageError as error:
        raise StorageError(f"{file} is no certificate of a proof: {error}") from error


def _read(file: Path) -> bytes:
    """The bytes of a regular file of a certificate's size."""
    from gaitopt.proof.certificate import LARGEST_FILE
    from gaitopt.store.files import reason

    try:
        if file.exists() and not file.is_file():
            raise StorageError(f"{file} is no certificate of a proof: it is no regular file")
        with file.open("rb") as stream:
            return stream.read(LARGEST_FILE + 1)
    except FileNotFoundError as error:
        raise StorageError(f"{file} is missing") from error
    except (OSError, ValueError) as error:
        raise StorageError(f"cannot read {file}: {reason(error)}") from error


def _report(proof: "Proof", file: Path, terminal: Terminal) -> int:
    terminal.show({**proof.to_record(), "certificate": str(file)}, _print, "certificate")
    return 0 if proof.proved else NOT_A_GAIT


def _statement(words: dict[str, Any]) -> list[tuple[str, str]]:
    """What the theorem is about, and what it does not say, row by row."""
    rows = [(key, str(value)) for key, value in words.items() if isinstance(value, str)]
    designed = words.get("designed", ())
    rows += [
        (key, f"{value} (designed)" if key in designed else value) for key, value in words.get("parameters", {}).items()
    ]
    return rows + [("not proved", text) for text in words.get("not_proved", ())]


def _print(console: "Console", record: dict[str, Any]) -> None:
    from gaitopt.problem.scalars import SCALARS
    from gaitopt.show.tables import section

    verdict = "proved" if record["proved"] else "NOT PROVED"
    stability = {True: ", stable", False: ", unstable", None: ""}[record["stable"]]
    console.print(f"{record['problem']}: {verdict}{stability}", style="bold")
    section(console, "statement", ("hypothesis", "value"), _statement(record["statement"]))
    claims = ((c["claim"], "yes" if c["proved"] else "NO", c["words"], c["margin"] or "") for c in record["claims"])
    section(console, "claims", ("claim", "proved", "statement", "margin"), claims, numbers=(3,))
    bounds = {**(record["state"] or {}), **{name: record.get(name) for name in SCALARS}}
    if record.get("interval"):
        bounds[record["parameter"]] = record["interval"].split("..")
    rows = ((name, *value) for name, value in bounds.items() if value is not None)
    section(console, "bounds", ("quantity", "from", "to"), rows, numbers=(1, 2))
    parts = ((str(k + 1), *m["re"], *m["im"]) for k, m in enumerate(record["multipliers"]))
    section(console, "multipliers", ("", "re from", "to", "im from", "to"), parts, numbers=(1, 2, 3, 4))
