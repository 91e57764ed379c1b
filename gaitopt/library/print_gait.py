"""Problems, gaits, walks and verifications as tables."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich.console import Console

from gaitopt.library.tables import number, section, with_degrees
from gaitopt.mechanics.cycle import ModeSequence
from gaitopt.mechanics.modes import Mode
from gaitopt.problem import PDSpec, Problem
from gaitopt.problem.parts import OpenSequence
from gaitopt.problem.scalars import label_of, relevant_scalars, scalar_values, state_unit, unit_of

FRICTION_KEYS = ("friction", "friction.static", "friction.kinetic")
LIST_COLUMNS = ("problem", "control", "friction", "phases; impact", "period", "radius", "", "about")
STABILITY = {True: "stable", False: "unstable"}


def print_problems(console: Console, problems: Sequence[tuple[Problem, Mapping[str, Any]]]) -> None:
    """Problems by walker, each with what is known of its gait; columns that are empty are left out."""
    for model in sorted({problem.walker.model for problem, _ in problems}):
        rows = [_listed(problem, record) for problem, record in problems if problem.walker.model == model]
        kept = [k for k, column in enumerate(LIST_COLUMNS) if column == "about" or any(row[k] for row in rows)]
        section(console, model, [LIST_COLUMNS[k] for k in kept], [[row[k] for k in kept] for row in rows])


def _listed(problem: Problem, record: Mapping[str, Any]) -> tuple[str, ...]:
    radius = record.get("spectral_radius")
    known = ("", "", "") if radius is None else (number(record["period"]), number(radius), STABILITY[radius < 1])
    kind = problem.control.type if problem.control.type != "none" else ""
    return problem.name, kind, friction(problem), str(problem.modes), *known, problem.about.strip()


def print_problem(console: Console, problem: Problem) -> None:
    """A problem: walker, control, mode sequence, guess, unknowns."""
    console.print(problem.name, style="bold")
    if problem.about:
        console.print(problem.about)
    section(console, f"walker {problem.walker.model}", ("key", "value", "unit", ""), _walker(problem), numbers=(1,))
    section(console, "contact and control", ("key", "value", "unit"), _contact(problem), numbers=(1,))
    for title, step in _steps(problem):
        section(console, title, ("phase", "mode"), _sequence(step))
    if problem.start is not None:
        values = problem.start.state.items()
        state = ((name, number(value), with_degrees(value, state_unit(name))) for name, value in values)
        section(console, "guess, just after the impact", ("state", "value", "unit"), state, numbers=(1,))
    if problem.free:
        unknowns = ((key, number(f.lower), number(f.upper), number(f.guess)) for key, f in problem.free.items())
        section(console, "unknown parameters", ("key", "from", "to", "guess"), unknowns, numbers=(1, 2, 3))
    if problem.objective:
        weights = ((name, number(weight)) for name, weight in problem.objective.items())
        section(console, "minimised", ("scalar", "weight"), weights, numbers=(1,))
    if problem.constraints:
        spans = ((name, number(s.minimum), number(s.maximum)) for name, s in problem.constraints.items())
        section(console, "constraints", ("scalar", "from", "to"), spans, numbers=(1, 2))


def print_gait(console: Console, record: Mapping[str, Any]) -> None:
    """A gait from its JSON object."""
    stable = STABILITY[record["spectral_radius"] < 1]
    console.print(f"{record['problem']}: {record['status']}, {stable}", style="bold")
    _print_motion(console, record)
    rows = ((number(m["re"]), number(m["im"]), number(abs(complex(m["re"], m["im"])))) for m in record["multipliers"])
    section(console, "Floquet multipliers", ("re", "im", "modulus"), rows, numbers=(0, 1, 2))
    if record["parameters"]:
        freed = ((key, number(value)) for key, value in record["parameters"].items())
        section(console, "parameters found", ("key", "value"), freed, numbers=(1,))
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
            f"{c['tolerance']:.2g}",
            "ok" if c["passed"] else "FAILED",
            c["note"],
        )
        for c in record["claims"]
    )
    title = "verified by forward simulation" if record["passed"] else "NOT verified by forward simulation"
    section(console, title, ("claim", "figure", "tolerance", "", ""), rows, numbers=(1, 2))


def _print_motion(console: Console, record: Mapping[str, Any], last: str = "") -> None:
    if record["phases"]:  # a walk without a complete step has neither phases nor figures
        steps = record["steps"] if isinstance(record.get("steps"), list) else [record]
        phases = [row for step in steps for row in _phases(step)]
        section(console, f"phases{last}", ("", "mode", "duration [s]"), phases, numbers=(2,))
        values = scalar_values(record)
        scalars = ((label_of(key), number(values[key]), unit_of(key)) for key in relevant_scalars([record]))
        section(console, f"figures{last}", ("", "value", "unit"), scalars, numbers=(1,))
    state = ((name, number(value), with_degrees(value, state_unit(name))) for name, value in record["state"].items())
    section(console, "state just after the impact", ("", "value", "unit"), state, numbers=(1,))


def _phases(step: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    rows = [
        (str(k), Mode.from_record(phase), number(phase["duration"])) for k, phase in enumerate(step["phases"], start=1)
    ]
    return [*rows, ("impact", step["impact"], "")]


def friction(problem: Problem) -> str:
    """The coefficient of friction, or static and kinetic coefficient."""
    return " / ".join(number(problem.parameters[key]) for key in FRICTION_KEYS if key in problem.parameters)


def _walker(problem: Problem) -> Iterable[tuple[str, str, str, str]]:
    for name, field in type(problem.walker).model_fields.items():
        value = getattr(problem.walker, name)
        words, _, unit = (field.description or "").partition(" [")
        yield name, number(value), with_degrees(value, unit.rstrip("]")), words


def _contact(problem: Problem) -> Iterable[tuple[str, str, str]]:
    for key, value in problem.parameters.items():
        if key.partition(".")[0] == "friction":
            yield key, number(value), unit_of(key)
    yield "impact_law", str(problem.impact_law), ""
    yield "control", problem.control.type, ""
    for key, value in problem.parameters.items():
        group, _, name = key.rpartition(".")
        if group == "control":
            yield name, number(value), unit_of(key) or "N m"
    if isinstance(problem.control, PDSpec) and problem.reference is not None:
        yield "reference", problem.reference.name, f"beyond its end: {problem.control.reference.beyond_end}"


def _steps(problem: Problem) -> Iterable[tuple[str, ModeSequence | OpenSequence]]:
    """The steps of the cycle with their titles, or what is known of an open one."""
    if isinstance(problem.modes, OpenSequence):
        yield "one step" if problem.modes.steps == 1 else f"at most {problem.modes.steps} steps", problem.modes
        return
    steps = problem.modes.steps
    for k, step in enumerate(steps, start=1):
        yield "one step" if len(steps) == 1 else f"step {k} of {len(steps)}", step


def _sequence(step: ModeSequence | OpenSequence) -> Iterable[tuple[str, str]]:
    if isinstance(step, OpenSequence):
        yield "1, 2, ...", "to be found"
        yield "impact", str(step.impact or "to be found")
        return
    for index, mode in enumerate(step.phases, start=1):
        yield str(index), str(mode)
    yield "impact", str(step.impact)
