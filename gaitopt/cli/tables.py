"""Problems, gaits, walks and verifications as tables that a person likes to read."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from gaitopt.cli.quantities import CONTROL_UNITS, QUANTITIES, number, state_unit, with_degrees
from gaitopt.problem import PDSpec, Problem

STABILITY = {True: "stable", False: "unstable"}


def table(
    title: str | None, columns: Sequence[str], rows: Iterable[Sequence[str]], *, numbers: Sequence[int] = ()
) -> Table:
    """A plain table; the columns at ``numbers`` are right-aligned, and words wrap in a narrow terminal."""
    made = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    for index, column in enumerate(columns):
        made.add_column(column, justify="right" if index in numbers else "left", overflow="fold")
    for row in rows:
        made.add_row(*row)
    return made


def print_problem(console: Console, problem: Problem) -> None:
    """What is asked: walker, control, mode sequence, guess, unknowns."""
    console.print(problem.name, style="bold")
    if problem.about:
        console.print(problem.about)
    console.print(table(f"walker {problem.walker.model}", ("key", "value", "unit", ""), _walker(problem), numbers=(1,)))
    console.print(table("contact and control", ("key", "value", "unit"), _contact(problem), numbers=(1,)))
    console.print(table("one step", ("phase", "mode"), _sequence(problem)))
    state = (
        (name, number(value), with_degrees(value, state_unit(name))) for name, value in problem.guess.state.items()
    )
    console.print(table("guess, just after the impact", ("state", "value", "unit"), state, numbers=(1,)))
    if problem.free:
        unknowns = ((key, number(f.lower), number(f.upper), number(f.guess)) for key, f in problem.free.items())
        console.print(table("unknown parameters", ("key", "from", "to", "guess"), unknowns, numbers=(1, 2, 3)))
    if problem.objective:
        weights = ((name, number(weight)) for name, weight in problem.objective.items())
        console.print(table("minimised", ("scalar", "weight"), weights, numbers=(1,)))
    if problem.constraints:
        spans = ((name, number(s.minimum), number(s.maximum)) for name, s in problem.constraints.items())
        console.print(table("constraints", ("scalar", "from", "to"), spans, numbers=(1, 2)))


def print_gait(console: Console, record: Mapping[str, Any]) -> None:
    """A gait from its JSON object."""
    stable = STABILITY[record["spectral_radius"] < 1]
    console.print(f"{record['problem']}: {record['status']}, {stable}", style="bold")
    _print_motion(console, record)
    rows = ((number(m["re"]), number(m["im"]), number(abs(complex(m["re"], m["im"])))) for m in record["multipliers"])
    console.print(table("Floquet multipliers", ("re", "im", "modulus"), rows, numbers=(0, 1, 2)))
    if record["parameters"]:
        found = ((key, number(value)) for key, value in record["parameters"].items())
        console.print(table("parameters found", ("key", "value"), found, numbers=(1,)))
    if record["verification"]:
        print_verification(console, record["verification"])


def print_walk(console: Console, record: Mapping[str, Any]) -> None:
    """A simulated walk from its JSON object."""
    console.print(f"{record['problem']}: {record['steps']} steps, {record['status']}", style="bold")
    console.print(record["message"])
    _print_motion(console, record, last=" of the last step")


def print_verification(console: Console, record: Mapping[str, Any]) -> None:
    """Every claim with its figure and tolerance."""
    rows = (
        (
            c["name"],
            f"{c['figure']:.2g}" if c["figure"] is not None else "-",
            f"{c['tolerance']:g}",
            _verdict(c),
            c["note"],
        )
        for c in record["claims"]
    )
    title = "verified by forward simulation" if record["passed"] else "NOT verified by forward simulation"
    console.print(table(title, ("claim", "figure", "tolerance", "", ""), rows, numbers=(1, 2)))


def _print_motion(console: Console, record: Mapping[str, Any], last: str = "") -> None:
    if record["phases"]:
        phases = [(str(k), p["mode"], number(p["duration"])) for k, p in enumerate(record["phases"], start=1)]
        phases.append(("impact", record["impact"], ""))
        console.print(table(f"phases{last}", ("", "mode", "duration [s]"), phases, numbers=(2,)))
    scalars = ((label, number(record[key]), unit) for key, (label, unit) in QUANTITIES.items() if key in record)
    console.print(table(f"figures{last}", ("", "value", "unit"), scalars, numbers=(1,)))
    state = ((name, number(value), with_degrees(value, state_unit(name))) for name, value in record["state"].items())
    console.print(table("state just after the impact", ("", "value", "unit"), state, numbers=(1,)))


def _verdict(claim: Mapping[str, Any]) -> str:
    return "ok" if claim["passed"] else "FAILED"


def _walker(problem: Problem) -> Iterable[tuple[str, str, str, str]]:
    for name, field in type(problem.walker).model_fields.items():
        value = getattr(problem.walker, name)
        words, _, unit = (field.description or "").partition(" [")
        yield name, number(value), with_degrees(value, unit.rstrip("]")), words


def _contact(problem: Problem) -> Iterable[tuple[str, str, str]]:
    yield "friction", number(problem.friction), ""
    yield "impact_law", str(problem.impact_law), ""
    yield "control", problem.control.type, ""
    for key, value in problem.parameters.items():
        group, _, name = key.rpartition(".")
        if group == "control":
            yield name, number(value), CONTROL_UNITS.get(name, "N m")
    if isinstance(problem.control, PDSpec) and problem.reference is not None:
        yield "reference", problem.reference.name, f"beyond its end: {problem.control.reference.beyond_end}"


def _sequence(problem: Problem) -> Iterable[tuple[str, str]]:
    for index, mode in enumerate(problem.sequence.phases, start=1):
        yield str(index), str(mode)
    yield "impact", str(problem.sequence.impact)
